//! The bodies of the kernels: one invocation each, no `std`.

pub mod sample;
pub mod split;
pub mod tables;

/// Product of two words, its upper and its lower word.
#[inline]
pub fn wide_product(x: u32, n: u32) -> (u32, u32) {
    let (a, b, c, d) = (x >> 16, x & 0xffff, n >> 16, n & 0xffff);
    let low = b * d;
    let middle = a * d + (low >> 16);
    let other = b * c + (middle & 0xffff);
    (a * c + (middle >> 16) + (other >> 16), other << 16 | (low & 0xffff))
}

#[cfg(test)]
mod tests {
    use super::wide_product;
    use scene::sampling::hash;

    #[test]
    fn the_wide_product_is_that_of_longer_words() {
        for k in 0..10_000 {
            let (x, n) = (hash(k), if k % 2 == 0 { hash(k + 1) } else { hash(k) >> 17 });
            let (high, low) = wide_product(x, n);
            assert_eq!(u64::from(high) << 32 | u64::from(low), u64::from(x) * u64::from(n));
        }
        assert_eq!(wide_product(u32::MAX, u32::MAX), (u32::MAX - 1, 1));
    }
}
