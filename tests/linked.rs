//! Checks that no function is linked that needs one of the kernels of OpenBLAS that `crates/link` leaves out.

use object::{Object, ObjectSymbol};

/// Returns whether a name is a BLAS or LAPACK function for a scalar type other than f64, such as `cblas_sgemm`,
/// `cblas_icamax`, `LAPACKE_zpotrf`, `cpotrf_`.
fn is_of_another_precision(name: &str) -> bool {
    let c = name.strip_prefix("cblas_i").or(name.strip_prefix("cblas_")).or(name.strip_prefix("LAPACKE_"));
    let fortran = || name.strip_suffix('_').filter(|name| name.len() > 3 && !name.contains('_'));
    c.or_else(fortran).is_some_and(|name| name.starts_with(['s', 'c', 'z']))
}

#[test]
fn nothing_is_linked_that_calls_a_kernel_that_is_left_out() {
    let bytes = std::fs::read(env!("CARGO_BIN_EXE_spharm")).expect("the program");
    let file = object::File::parse(&*bytes).expect("an executable");
    let linked = |symbol: &object::Symbol<'_, '_>| symbol.is_definition() && symbol.address() != 0;
    let names: Vec<&str> = file.symbols().filter(linked).filter_map(|symbol| symbol.name().ok()).collect();
    if !names.contains(&"cblas_dgemm") {
        eprintln!("skipped: the program has no table of symbols");
        return;
    }
    assert!(["cblas_sgemm", "cblas_izamax", "cpotrf_", "strsm_"].into_iter().all(is_of_another_precision));
    let other: Vec<&&str> = names.iter().filter(|name| is_of_another_precision(name)).collect();
    assert!(other.is_empty(), "{other:?}");
}
