//! Decompositions and factors reproduce the matrix that they are of.

use spharm_linalg::{
    Accum, Cholesky, Mat, MatMut, MatRef, NotPositiveDefinite, SparsePattern, SparseSum, SymmetricEigen, ThinSvd,
    add_gram, cholesky_in_place, matmul, solve_lower, solve_upper, triangularise,
};

/// Returns deterministic values in [-1, 1] that belong to a matrix of full rank.
fn filled(rows: usize, columns: usize) -> Mat<f64> {
    Mat::from_fn(rows, columns, |i, j| (1.0 + 7.0 * i as f64 + 3.3 * j as f64 + (i * j) as f64).sin())
}

/// Returns the product by the definition.
fn product(a: &Mat<f64>, b: &Mat<f64>) -> Mat<f64> {
    Mat::from_fn(a.nrows(), b.ncols(), |i, j| (0..a.ncols()).map(|k| a[(i, k)] * b[(k, j)]).sum())
}

fn transposed(a: MatRef<'_, f64>) -> Mat<f64> {
    a.transpose().to_owned()
}

/// Returns a symmetric positive definite matrix.
fn definite(order: usize) -> Mat<f64> {
    let a = filled(order + 3, order);
    let gram = product(&transposed(a.as_ref()), &a);
    Mat::from_fn(order, order, |i, j| gram[(i, j)] + if i == j { 1.0 } else { 0.0 })
}

fn assert_close(found: &Mat<f64>, expected: &Mat<f64>) {
    assert_eq!(found.shape(), expected.shape());
    for j in 0..found.ncols() {
        for i in 0..found.nrows() {
            let off = found[(i, j)] - expected[(i, j)];
            assert!(off.abs() < 1e-10, "row {i}, column {j}: {} for {}", found[(i, j)], expected[(i, j)]);
        }
    }
}

#[test]
fn products_are_sums_of_products() {
    let (a, b) = (filled(5, 9), filled(9, 4));
    let mut out = Mat::from_fn(5, 4, |i, j| (i + j) as f64);
    let expected = product(&a, &b);
    let expected = Mat::from_fn(5, 4, |i, j| out[(i, j)] - 2.0 * expected[(i, j)]);
    matmul(out.as_mut(), Accum::Add, a.as_ref(), b.as_ref(), -2.0);
    assert_close(&out, &expected);
}

#[test]
fn a_gram_matrix_leaves_what_is_above_its_diagonal() {
    let a = filled(6, 40);
    let expected = product(&a, &transposed(a.as_ref()));
    let mut out = Mat::from_fn(6, 6, |_, _| 7.0);
    add_gram(out.as_mut(), a.as_ref(), 1.0);
    let expected = Mat::from_fn(6, 6, |i, j| 7.0 + if i >= j { expected[(i, j)] } else { 0.0 });
    assert_close(&out, &expected);
}

#[test]
fn a_cholesky_factor_solves_and_inverts() {
    for order in [1, 4, 70] {
        let matrix = definite(order);
        let right = filled(order, 3);
        let factor = Cholesky::new(matrix.as_ref()).expect("positive definite");
        assert_close(&product(&matrix, &factor.solve(right.as_ref())), &right);
        let identity = Mat::from_fn(order, order, |i, j| f64::from(u8::from(i == j)));
        assert_close(&product(&matrix, &factor.inverse()), &identity);
        let values = SymmetricEigen::new(matrix.as_ref()).expect("finite").values();
        let logarithms: f64 = values.iter().map(|value| value.ln()).sum();
        assert!((factor.log_determinant() - logarithms).abs() < 1e-9);

        let mut in_place = matrix.clone();
        cholesky_in_place(in_place.as_mut()).expect("positive definite");
        let mut solved = right.clone();
        solve_lower(in_place.as_ref(), solved.as_mut());
        solve_upper(in_place.transpose(), solved.as_mut());
        assert_close(&product(&matrix, &solved), &right);
    }
}

#[test]
fn the_first_column_that_isnt_definite_is_stated() {
    let matrix = Mat::from_fn(90, 90, |i, j| {
        if i != j {
            0.0
        } else if i == 80 {
            -1.0
        } else {
            1.0
        }
    });
    let expected = NotPositiveDefinite { column: 80 };
    assert_eq!(cholesky_in_place(matrix.clone().as_mut()), Err(expected));
    assert_eq!(Cholesky::new(matrix.as_ref()).err(), Some(expected));
}

#[test]
fn decompositions_reproduce_the_matrix() {
    for (rows, columns) in [(1, 1), (12, 5), (5, 12), (80, 80)] {
        let matrix = filled(rows, columns);
        let found = ThinSvd::new(matrix.as_ref()).expect("finite");
        let (u, singular, v) = (found.u(), found.singular(), found.v());
        let scaled = Mat::from_fn(rows, singular.len(), |i, k| u[(i, k)] * singular[k]);
        assert_close(&product(&scaled, &transposed(v)), &matrix);
        assert!(singular.is_sorted_by(|a, b| a >= b), "in decreasing order");

        let mut r = matrix.clone();
        triangularise(r.as_mut());
        assert!((0..columns).all(|j| (j + 1..rows).all(|i| r[(i, j)] == 0.0)), "zeros below the diagonal");
        assert_close(&product(&transposed(r.as_ref()), &r), &product(&transposed(matrix.as_ref()), &matrix));
    }
    let matrix = definite(40);
    let found = SymmetricEigen::new(matrix.as_ref()).expect("finite");
    let (values, vectors) = (found.values(), found.vectors());
    let scaled = Mat::from_fn(40, 40, |i, k| vectors[(i, k)] * values[k]);
    assert_close(&product(&scaled, &transposed(vectors)), &matrix);
    assert!(values.is_sorted(), "in ascending order");
}

/// In a matrix of rank 150, the singular values after the 150th are rounding errors.
#[test]
fn a_triangular_factor_has_the_rank_of_the_matrix() {
    let (places, columns) = (150, 441);
    let mut random = 1u64;
    let few = Mat::from_fn(places, columns, |_, _| {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (random >> 33) as f64 / (1u64 << 31) as f64 - 0.5
    });
    let mut five_times = Mat::from_fn(5 * places, columns, |i, j| few[(i / 5, j)]);
    triangularise(five_times.as_mut());
    let triangle = five_times.as_ref().subrows(0, columns);
    let singular = ThinSvd::new(triangle).expect("finite").singular();
    let largest = singular[0];
    assert!(singular[places - 1] > 0.1 * largest && singular[places] < 20.0 * f64::EPSILON * largest);
}

/// Returns the entries of the Laplacian of a ring of vertices plus the identity, each entry in several parts and in no
/// order, and the matrix.
fn ring(order: usize) -> (Vec<[usize; 2]>, Vec<f64>, Mat<f64>) {
    let (mut places, mut values) = (Vec::new(), Vec::new());
    for v in (0..order).rev() {
        let next = (v + 1) % order;
        for (place, value) in [([v, v], 1.0), ([next, v], -1.0), ([v, next], -1.0), ([next, next], 1.0), ([v, v], 1.0)]
        {
            places.push(place);
            values.push(value);
        }
    }
    let mut matrix = Mat::zeros(order, order);
    places.iter().zip(&values).for_each(|(&[row, column], value)| matrix[(row, column)] += value);
    (places, values, matrix)
}

#[test]
fn sparse_factors_solve() {
    let order = 50;
    let (places, values, matrix) = ring(order);
    let right = filled(order, 2);
    let mut summed = right.clone();
    SparseSum::new(order, &places)
        .expect("within the matrix")
        .factor(&values)
        .expect("definite")
        .solve(summed.as_mut());
    assert_close(&product(&matrix, &summed), &right);

    let (mut starts, mut rows, mut lower) = (vec![0], Vec::new(), Vec::new());
    for column in 0..order {
        for row in (column..order).filter(|&row| matrix[(row, column)] != 0.0) {
            rows.push(row);
            lower.push(matrix[(row, column)]);
        }
        starts.push(rows.len());
    }
    let pattern = SparsePattern::new(starts, rows).expect("enough memory");
    assert_eq!(pattern.entries(), 2 * order);
    let mut columns: Vec<f64> = (0..2).flat_map(|c| (0..order).map(move |i| (i, c))).map(|at| right[at]).collect();
    let factor = pattern.factor(&lower).expect("definite");
    factor.solve(MatMut::from_column_major_slice_mut(&mut columns, order, 2));
    assert_close(&Mat::from_fn(order, 2, |i, c| columns[c * order + i]), &summed);

    lower[0] = -1.0;
    assert!(pattern.factor(&lower).is_none(), "not positive definite");
    assert!(SparseSum::new(order, &[[0, order]]).is_none(), "an entry outside of the matrix");
}
