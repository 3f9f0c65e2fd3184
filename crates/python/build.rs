//! Build script: links without most of OpenBLAS's kernels and without copies of functions.

fn main() {
    spharm_link::leave_out_kernels();
    spharm_link::fold_identical_functions();
}
