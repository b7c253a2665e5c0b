//! Registers of lanes of 32 bits, each also two numbers of 16 bits, whose products are exact: the same bits on every
//! machine.

use pulp::Arch;
#[cfg(target_arch = "x86_64")]
use pulp::{
    NullaryFnOnce, cast,
    x86::{V3, V4},
};

use crate::kernel::low_rank::LANES;

/// Words of a lane each.
pub(super) type U32x16 = [u32; LANES as usize];

/// Operations of a product on `u32x16`s.
pub(super) trait Lanes: Copy {
    /// A register.
    type Word: Copy;
    /// Registers of a `u32x16`.
    const EACH: usize;

    fn load(self, lanes: &U32x16, k: usize) -> Self::Word;
    fn store(self, lanes: &mut U32x16, k: usize, word: Self::Word);
    fn splat(self, word: u32) -> Self::Word;
    /// Nibbles k and k + 4, for k from 0 to 3.
    fn nibbles(self, word: Self::Word) -> [Self::Word; 4];
    /// Bytes k and k + 2, for k 0 and 1.
    fn bytes(self, word: Self::Word) -> [Self::Word; 2];
    /// Bytes k and k + 2 with their sign, for k 0 and 1.
    fn signed(self, word: Self::Word) -> [Self::Word; 2];
    /// The lower numbers of both.
    fn low(self, a: Self::Word, b: Self::Word) -> Self::Word;
    /// The upper numbers of both.
    fn high(self, a: Self::Word, b: Self::Word) -> Self::Word;
    fn add(self, a: Self::Word, b: Self::Word) -> Self::Word;
    fn sub(self, a: Self::Word, b: Self::Word) -> Self::Word;
    /// The products of the numbers of a and b, added up.
    fn products(self, a: Self::Word, b: Self::Word) -> Self::Word;
    /// Sums of all lanes.
    fn totals(self, vectors: &[U32x16; 4]) -> [i32; 4];
    /// Adds `word · step`, rounded once after the product and once after the sum.
    fn add_scaled(self, row: &mut [f32; LANES as usize], k: usize, word: Self::Word, step: f32);
}

/// Code compiled for each kind of registers.
pub(super) trait WithLanes {
    fn with<L: Lanes>(self, lanes: L);
}

/// Runs a task with the widest registers of this machine.
pub(super) fn dispatch<T: WithLanes>(task: T) {
    match Arch::new() {
        #[cfg(target_arch = "x86_64")]
        Arch::V4(v4) => match Vnni::try_new() {
            Some(vnni) => vnni.vectorize(Bound(v4, task)),
            None => v4.vectorize(Bound(v4, task)),
        },
        #[cfg(target_arch = "x86_64")]
        Arch::V3(v3) => v3.vectorize(Bound(v3, task)),
        _ => task.with(Plain),
    }
}

#[cfg(target_arch = "x86_64")]
pulp::simd_type!({
    /// As [`V4`], and [`Lanes::products`] with an addition to their sum in one instruction, which the compiler finds.
    struct Vnni {
        sse: f!("sse"),
        sse2: f!("sse2"),
        fxsr: f!("fxsr"),
        sse3: f!("sse3"),
        ssse3: f!("ssse3"),
        sse4_1: f!("sse4.1"),
        sse4_2: f!("sse4.2"),
        popcnt: f!("popcnt"),
        avx: f!("avx"),
        avx2: f!("avx2"),
        bmi1: f!("bmi1"),
        bmi2: f!("bmi2"),
        fma: f!("fma"),
        lzcnt: f!("lzcnt"),
        avx512f: f!("avx512f"),
        avx512bw: f!("avx512bw"),
        avx512cd: f!("avx512cd"),
        avx512dq: f!("avx512dq"),
        avx512vl: f!("avx512vl"),
        avx512vnni: f!("avx512vnni"),
    }
});

#[cfg(target_arch = "x86_64")]
struct Bound<L, T>(L, T);

#[cfg(target_arch = "x86_64")]
impl<L: Lanes, T: WithLanes> NullaryFnOnce for Bound<L, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.1.with(self.0);
    }
}

#[cfg(target_arch = "x86_64")]
impl Lanes for V4 {
    type Word = pulp::u32x16;
    const EACH: usize = 1;

    #[inline(always)]
    fn load(self, lanes: &U32x16, _: usize) -> Self::Word {
        cast(*lanes)
    }

    #[inline(always)]
    fn store(self, lanes: &mut U32x16, _: usize, word: Self::Word) {
        *lanes = cast(word);
    }

    #[inline(always)]
    fn splat(self, word: u32) -> Self::Word {
        self.splat_u32x16(word)
    }

    #[inline(always)]
    fn nibbles(self, word: Self::Word) -> [Self::Word; 4] {
        let mask = self.splat_u32x16(0x000f_000f);
        [
            self.and_u32x16(word, mask),
            self.and_u32x16(self.shr_const_u32x16::<4>(word), mask),
            self.and_u32x16(self.shr_const_u32x16::<8>(word), mask),
            self.and_u32x16(self.shr_const_u32x16::<12>(word), mask),
        ]
    }

    #[inline(always)]
    fn bytes(self, word: Self::Word) -> [Self::Word; 2] {
        let mask = self.splat_u32x16(0x00ff_00ff);
        [self.and_u32x16(word, mask), self.and_u32x16(self.shr_const_u32x16::<8>(word), mask)]
    }

    #[inline(always)]
    fn signed(self, word: Self::Word) -> [Self::Word; 2] {
        let lower = self.shl_const_i16x32::<8>(cast(word));
        [cast(self.shr_const_i16x32::<8>(lower)), cast(self.shr_const_i16x32::<8>(cast(word)))]
    }

    #[inline(always)]
    fn low(self, a: Self::Word, b: Self::Word) -> Self::Word {
        self.or_u32x16(self.and_u32x16(a, self.splat_u32x16(0xffff)), self.shl_const_u32x16::<16>(b))
    }

    #[inline(always)]
    fn high(self, a: Self::Word, b: Self::Word) -> Self::Word {
        self.or_u32x16(self.shr_const_u32x16::<16>(a), self.and_u32x16(b, self.splat_u32x16(0xffff_0000)))
    }

    #[inline(always)]
    fn add(self, a: Self::Word, b: Self::Word) -> Self::Word {
        self.wrapping_add_u32x16(a, b)
    }

    #[inline(always)]
    fn sub(self, a: Self::Word, b: Self::Word) -> Self::Word {
        self.wrapping_sub_u32x16(a, b)
    }

    #[inline(always)]
    fn products(self, a: Self::Word, b: Self::Word) -> Self::Word {
        cast(self.multiply_wrapping_add_adjacent_i16x32(cast(a), cast(b)))
    }

    #[inline(always)]
    fn totals(self, vectors: &[U32x16; 4]) -> [i32; 4] {
        let v3: V3 = *self;
        v3.totals(vectors)
    }

    #[inline(always)]
    fn add_scaled(self, row: &mut [f32; LANES as usize], _: usize, word: Self::Word, step: f32) {
        let product = self.mul_f32x16(self.convert_i32x16_to_f32x16(cast(word)), self.splat_f32x16(step));
        *row = cast(self.add_f32x16(cast(*row), product));
    }
}

#[cfg(target_arch = "x86_64")]
impl Lanes for V3 {
    type Word = pulp::u32x8;
    const EACH: usize = 2;

    #[inline(always)]
    fn load(self, lanes: &U32x16, k: usize) -> Self::Word {
        cast(lanes.as_chunks::<8>().0[k])
    }

    #[inline(always)]
    fn store(self, lanes: &mut U32x16, k: usize, word: Self::Word) {
        lanes.as_chunks_mut::<8>().0[k] = cast(word);
    }

    #[inline(always)]
    fn splat(self, word: u32) -> Self::Word {
        self.splat_u32x8(word)
    }

    #[inline(always)]
    fn nibbles(self, word: Self::Word) -> [Self::Word; 4] {
        let mask = self.splat_u32x8(0x000f_000f);
        [
            self.and_u32x8(word, mask),
            self.and_u32x8(self.shr_const_u32x8::<4>(word), mask),
            self.and_u32x8(self.shr_const_u32x8::<8>(word), mask),
            self.and_u32x8(self.shr_const_u32x8::<12>(word), mask),
        ]
    }

    #[inline(always)]
    fn bytes(self, word: Self::Word) -> [Self::Word; 2] {
        let mask = self.splat_u32x8(0x00ff_00ff);
        [self.and_u32x8(word, mask), self.and_u32x8(self.shr_const_u32x8::<8>(word), mask)]
    }

    #[inline(always)]
    fn signed(self, word: Self::Word) -> [Self::Word; 2] {
        let lower = self.shl_const_i16x16::<8>(cast(word));
        [cast(self.shr_const_i16x16::<8>(lower)), cast(self.shr_const_i16x16::<8>(cast(word)))]
    }

    #[inline(always)]
    fn low(self, a: Self::Word, b: Self::Word) -> Self::Word {
        self.or_u32x8(self.and_u32x8(a, self.splat_u32x8(0xffff)), self.shl_const_u32x8::<16>(b))
    }

    #[inline(always)]
    fn high(self, a: Self::Word, b: Self::Word) -> Self::Word {
        self.or_u32x8(self.shr_const_u32x8::<16>(a), self.and_u32x8(b, self.splat_u32x8(0xffff_0000)))
    }

    #[inline(always)]
    fn add(self, a: Self::Word, b: Self::Word) -> Self::Word {
        self.wrapping_add_u32x8(a, b)
    }

    #[inline(always)]
    fn sub(self, a: Self::Word, b: Self::Word) -> Self::Word {
        self.wrapping_sub_u32x8(a, b)
    }

    #[inline(always)]
    fn products(self, a: Self::Word, b: Self::Word) -> Self::Word {
        cast(self.multiply_wrapping_add_adjacent_i16x16(cast(a), cast(b)))
    }

    #[inline(always)]
    fn totals(self, vectors: &[U32x16; 4]) -> [i32; 4] {
        let a = self.add(self.load(&vectors[0], 0), self.load(&vectors[0], 1));
        let b = self.add(self.load(&vectors[1], 0), self.load(&vectors[1], 1));
        let c = self.add(self.load(&vectors[2], 0), self.load(&vectors[2], 1));
        let d = self.add(self.load(&vectors[3], 0), self.load(&vectors[3], 1));
        let ab = self.horizontal_add_pack_u32x8(a, b);
        let cd = self.horizontal_add_pack_u32x8(c, d);
        let [low, high]: [pulp::u32x4; 2] = cast(self.horizontal_add_pack_u32x8(ab, cd));
        cast(self.wrapping_add_u32x4(low, high))
    }

    #[inline(always)]
    fn add_scaled(self, row: &mut [f32; LANES as usize], k: usize, word: Self::Word, step: f32) {
        let row = &mut row.as_chunks_mut::<8>().0[k];
        let product = self.mul_f32x8(self.convert_i32x8_to_f32x8(cast(word)), self.splat_f32x8(step));
        *row = cast(self.add_f32x8(cast(*row), product));
    }
}

/// Without registers that are known by name: the compiler takes those that it finds.
#[derive(Clone, Copy)]
pub(super) struct Plain;

impl Lanes for Plain {
    type Word = U32x16;
    const EACH: usize = 1;

    #[inline(always)]
    fn load(self, lanes: &U32x16, _: usize) -> U32x16 {
        *lanes
    }

    #[inline(always)]
    fn store(self, lanes: &mut U32x16, _: usize, word: U32x16) {
        *lanes = word;
    }

    #[inline(always)]
    fn splat(self, word: u32) -> U32x16 {
        [word; LANES as usize]
    }

    #[inline(always)]
    fn nibbles(self, word: U32x16) -> [U32x16; 4] {
        [0, 4, 8, 12].map(|bits| word.map(|word| word >> bits & 0x000f_000f))
    }

    #[inline(always)]
    fn bytes(self, word: U32x16) -> [U32x16; 2] {
        [0, 8].map(|bits| word.map(|word| word >> bits & 0x00ff_00ff))
    }

    #[inline(always)]
    fn signed(self, word: U32x16) -> [U32x16; 2] {
        let both = |first: u32, second: u32| first as u8 as i8 as u32 & 0xffff | (second as u8 as i8 as u32) << 16;
        [word.map(|word| both(word, word >> 16)), word.map(|word| both(word >> 8, word >> 24))]
    }

    #[inline(always)]
    fn low(self, a: U32x16, b: U32x16) -> U32x16 {
        core::array::from_fn(|k| a[k] & 0xffff | b[k] << 16)
    }

    #[inline(always)]
    fn high(self, a: U32x16, b: U32x16) -> U32x16 {
        core::array::from_fn(|k| a[k] >> 16 | b[k] & 0xffff_0000)
    }

    #[inline(always)]
    fn add(self, a: U32x16, b: U32x16) -> U32x16 {
        core::array::from_fn(|k| a[k].wrapping_add(b[k]))
    }

    #[inline(always)]
    fn sub(self, a: U32x16, b: U32x16) -> U32x16 {
        core::array::from_fn(|k| a[k].wrapping_sub(b[k]))
    }

    #[inline(always)]
    fn products(self, a: U32x16, b: U32x16) -> U32x16 {
        let upper = |word: u32| (word as i32) >> 16;
        let product = |a: u32, b: u32| upper(a << 16) * upper(b << 16) + upper(a) * upper(b);
        core::array::from_fn(|k| product(a[k], b[k]) as u32)
    }

    #[inline(always)]
    fn totals(self, vectors: &[U32x16; 4]) -> [i32; 4] {
        vectors.map(|lanes| lanes.iter().fold(0u32, |sum, &word| sum.wrapping_add(word)) as i32)
    }

    #[inline(always)]
    fn add_scaled(self, row: &mut [f32; LANES as usize], _: usize, word: U32x16, step: f32) {
        row.iter_mut().zip(word).for_each(|(row, word)| *row += word as i32 as f32 * step);
    }
}

#[cfg(all(test, target_arch = "x86_64"))]
mod tests {
    use scene::sampling::hash3;

    use super::*;

    /// All that can be done with registers of two `u32x16`s.
    fn results<L: Lanes>(l: L, a: L::Word, b: L::Word) -> [L::Word; 19] {
        let ([c, d, e, f], [g, h]) = (l.nibbles(a), l.bytes(a));
        let [m, n] = [l.low(a, b), l.high(a, b)];
        // Of elements and quantised values, as products have them.
        let [u, v] = l.signed(a);
        let [o, p, q, r, s, t] = [c, d, e, f, g, h].map(|x| l.products(x, b));
        [c, d, e, f, g, h, m, n, o, p, q, r, s, t, l.add(a, b), l.sub(a, b), l.splat(7), u, v]
    }

    fn all<L: Lanes>(l: L, vectors: &[U32x16; 4]) -> ([U32x16; 19], [i32; 4], [u32; LANES as usize]) {
        let mut out = [[0; LANES as usize]; 19];
        let mut row = [0.25f32; LANES as usize];
        for k in 0..L::EACH {
            let a = l.load(&vectors[0], k);
            let b = l.load(&vectors[1], k);
            out.iter_mut().zip(results(l, a, b)).for_each(|(out, word)| l.store(out, k, word));
            l.add_scaled(&mut row, k, a, 3e-7);
        }
        (out, l.totals(vectors), row.map(f32::to_bits))
    }

    #[test]
    fn every_kind_of_registers_gives_the_same_bits() {
        let vectors: [U32x16; 4] = core::array::from_fn(|g| core::array::from_fn(|k| hash3(g as u32, k as u32, 5)));
        let expected = all(Plain, &vectors);
        let kinds = [V3::try_new().map(|l| all(l, &vectors)), V4::try_new().map(|l| all(l, &vectors))];
        for found in kinds.into_iter().flatten() {
            assert_eq!(found, expected);
        }
        let mut other = vectors;
        other[1][3] ^= 1 << 9;
        assert_ne!(all(Plain, &other), expected);
    }
}
