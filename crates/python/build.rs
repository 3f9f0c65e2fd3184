//! Build script: links without most of OpenBLAS's kernels.

fn main() {
    spharm_link::leave_out_kernels();
}
