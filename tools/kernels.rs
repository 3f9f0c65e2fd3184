//! Chooses the kernels that OpenBLAS uses in this program.
//!
//! OpenBLAS chooses its kernels in an initialiser that runs before `main`. A program can change OpenBLAS's choice only
//! by environment variables. Therefore, an initialiser of this program sets the environment before OpenBLAS's
//! initialiser runs. No library crate of this project sets the environment, because a library that is loaded into a
//! running process would change the environment while other threads read it.

#![allow(unsafe_code)]

/// Runs before OpenBLAS's own initialiser, which has no priority and therefore runs last.
#[used]
#[unsafe(link_section = ".init_array.00200")]
static CHOOSE_KERNELS: extern "C" fn() = choose_kernels;

/// Selects OpenBLAS's kernels for this processor, and starts OpenBLAS with a single thread. OpenBLAS creates further
/// threads and their buffers when a computation requests them.
///
/// OpenBLAS 0.3.20 treats unknown processors, such as the Xeons of 2023, as a Pentium 4, and then runs at a fifth of
/// the possible speed. OPENBLAS_CORETYPE and OPENBLAS_NUM_THREADS take precedence if the user has set them.
extern "C" fn choose_kernels() {
    use std::arch::is_x86_feature_detected as has;
    let wide = has!("avx512f") && has!("avx512cd") && has!("avx512bw") && has!("avx512dq") && has!("avx512vl");
    let kernels = match (wide, has!("avx2") && has!("fma")) {
        (true, _) => Some(c"SkylakeX"),
        (false, true) => Some(c"Haswell"),
        (false, false) => None,
    };
    let set = |name: &std::ffi::CStr, value: &std::ffi::CStr| {
        // SAFETY: both strings end in a zero byte. `setenv` must not run while another thread reads or changes the
        // environment. The loader runs the initialisers of an executable on the process's first thread before `main`,
        // and no earlier initialiser starts a thread.
        unsafe { libc::setenv(name.as_ptr(), value.as_ptr(), 0) };
    };
    if let Some(kernels) = kernels {
        set(c"OPENBLAS_CORETYPE", kernels);
    }
    set(c"OPENBLAS_NUM_THREADS", c"1");
}
