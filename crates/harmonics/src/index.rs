//! The numbering of the basis functions: the function of degree l and order m is column `l^2 + l + m`.

/// Returns the number of harmonics up to degree `max_degree`, inclusive: `K = (L + 1)^2`.
pub const fn basis_size(max_degree: usize) -> usize {
    (max_degree + 1) * (max_degree + 1)
}

/// Returns the number of harmonics of one degree: `2 l + 1`.
pub const fn order_count(degree: usize) -> usize {
    2 * degree + 1
}

/// Returns the first column of a degree: `l^2`.
pub const fn first_column(degree: usize) -> usize {
    degree * degree
}

/// Returns the column of a degree and order.
///
/// # Panics
///
/// If `|order| > degree`.
pub const fn column(degree: usize, order: isize) -> usize {
    assert!(order.unsigned_abs() <= degree, "the order must be from -degree to degree");
    (degree * degree + degree).wrapping_add_signed(order)
}

/// Returns the degree and order of a column.
pub const fn degree_order(column: usize) -> (usize, isize) {
    let degree = column.isqrt();
    (degree, column as isize - (degree * degree + degree) as isize)
}

/// Returns L if `rows` is `(L + 1)^2` for some L, else `None`.
pub const fn max_degree_of(rows: usize) -> Option<usize> {
    let root = rows.isqrt();
    if root > 0 && root * root == rows { Some(root - 1) } else { None }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_enumerate_degrees_then_orders() {
        let mut next = 0;
        for degree in 0..40usize {
            for order in -(degree as isize)..=degree as isize {
                assert_eq!(column(degree, order), next);
                assert_eq!(degree_order(next), (degree, order));
                next += 1;
            }
            assert_eq!(next, basis_size(degree));
            assert_eq!(max_degree_of(next), Some(degree));
            assert_eq!(max_degree_of(next + 1), None);
        }
        assert_eq!(max_degree_of(0), None);
    }
}
