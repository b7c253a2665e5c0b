//! Keeps the compilers of the drivers from rewriting float arithmetic.

/// Decorates the result of every float operation `NoContraction`. Without it spirv-opt and the drivers rewrite `a*b +
/// a*c` into `a*(b + c)`, and CPU and GPU differ by up to 10⁻³ under cancellation.
pub fn forbid_contraction(words: &[u32]) -> Vec<u32> {
    const HEADER: usize = 5;
    const DECORATE: u32 = 71;
    const MEMBER_DECORATE: u32 = 72;
    const NO_CONTRACTION: u32 = 42;
    let mut position = HEADER;
    let mut annotations_end = HEADER;
    let mut decorations = Vec::new();
    while position < words.len() {
        let length = (words[position] >> 16) as usize;
        let operation = words[position] & 0xffff;
        if is_float_arithmetic(operation) {
            decorations.extend([3 << 16 | DECORATE, words[position + 2], NO_CONTRACTION]);
        }
        if matches!(operation, DECORATE | MEMBER_DECORATE) {
            annotations_end = position + length;
        }
        position += length.max(1);
    }
    [&words[..annotations_end], &decorations, &words[annotations_end..]].concat()
}

/// OpFNegate, OpFAdd, OpFSub, OpFMul, OpFDiv, OpFRem … OpDot: the operations that `NoContraction` may stand on.
fn is_float_arithmetic(operation: u32) -> bool {
    matches!(operation, 127 | 129 | 131 | 133 | 136 | 140..=148)
}

#[cfg(test)]
mod tests {
    use super::forbid_contraction;

    #[test]
    fn decorations_follow_the_annotations() {
        let header = [0x0723_0203, 0x0001_0500, 0, 10, 0];
        let annotation = [4 << 16 | 71, 7, 6, 16];
        let add = [5 << 16 | 129, 1, 9, 2, 3];
        let words = [&header[..], &annotation, &add].concat();
        let expected = [&header[..], &annotation, &[3 << 16 | 71, 9, 42], &add].concat();
        assert_eq!(forbid_contraction(&words), expected);
        // An integer addition stays as it is.
        let integer = [&header[..], &annotation, &[5 << 16 | 128, 1, 9, 2, 3]].concat();
        assert_eq!(forbid_contraction(&integer), integer);
    }
}
