//! Short arrays that the compiler keeps in vector registers.
//!
//! Everything here is always inlined, so that it is compiled for the processor of the kernel that uses it.

/// Returns `W` values from `values[at]` on.
#[inline(always)]
pub(crate) fn load<const W: usize>(values: &[f64], at: usize) -> [f64; W] {
    let mut lanes = [0.0; W];
    lanes.copy_from_slice(&values[at..at + W]);
    lanes
}

/// Returns `a b + c`. With `FMA`, the result is rounded only once, by a single instruction if the processor has one.
#[inline(always)]
pub(crate) fn fused<const FMA: bool>(a: f64, b: f64, c: f64) -> f64 {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}
