//! Exports the C functions that the page's script calls.
//!
//! All functions use one [`View`]. The functions `set_*` allocate an array, and return the address to which the
//! script copies its contents. `plan`, `evaluate`, `refer` and `measure` return 1 on success and 0 on an error. The
//! other functions return the address of a result, which is valid until the next call. A pointer is an offset into
//! the module's memory, which the script reads and writes. No function dereferences a pointer.
#![expect(
    unsafe_code,
    reason = "a name that is exported unmangled is unsafe to state, as names might clash; these don't"
)]

use std::cell::RefCell;

use crate::view::{View, ViewError};

thread_local! {
    static VIEW: RefCell<View> = RefCell::default();
    static REFERENCE: RefCell<Vec<f32>> = RefCell::default();
}

/// Allocates an array of `length` zeros, and returns its address.
fn room<T: Copy + Default>(array: &mut Vec<T>, length: usize) -> *mut T {
    array.clear();
    array.resize(length, T::default());
    array.as_mut_ptr()
}

fn done(result: Result<(), ViewError>) -> u32 {
    u32::from(result.is_ok())
}

/// Allocates the array of n directions, f64 (n, 3), and returns its address.
#[unsafe(no_mangle)]
pub extern "C" fn set_directions(count: usize) -> *mut f64 {
    VIEW.with_borrow_mut(|view| room(&mut view.directions, 3 * count))
}

/// Allocates the array of m triangles, u32 (m, 3), and returns its address.
#[unsafe(no_mangle)]
pub extern "C" fn set_faces(count: usize) -> *mut u32 {
    VIEW.with_borrow_mut(|view| room(&mut view.faces, 3 * count))
}

/// Allocates the array of coefficients, f64 (K, 3), and returns its address.
#[unsafe(no_mangle)]
pub extern "C" fn set_coefficients(rows: usize) -> *mut f64 {
    VIEW.with_borrow_mut(|view| room(&mut view.coefficients, 3 * rows))
}

/// Allocates the array of the reference's n offsets, i16 (n, 3), and returns its address.
#[unsafe(no_mangle)]
pub extern "C" fn set_offsets(count: usize) -> *mut i16 {
    VIEW.with_borrow_mut(|view| room(&mut view.offsets, 3 * count))
}

/// Calls [`View::plan`]. Returns 1 on success, 0 on an error.
#[unsafe(no_mangle)]
pub extern "C" fn plan(max_degree: usize) -> u32 {
    VIEW.with_borrow_mut(|view| done(view.plan(max_degree)))
}

/// Calls [`View::evaluate`]. Returns 1 on success, 0 on an error.
#[unsafe(no_mangle)]
pub extern "C" fn evaluate(degree: usize) -> u32 {
    VIEW.with_borrow_mut(|view| done(view.evaluate(degree)))
}

/// Calls [`View::refer`]. Returns 1 on success, 0 on an error.
#[unsafe(no_mangle)]
pub extern "C" fn refer(step: f64) -> u32 {
    VIEW.with_borrow_mut(|view| done(view.refer(step)))
}

/// Calls [`View::measure`]. Returns 1 on success, 0 on an error.
#[unsafe(no_mangle)]
pub extern "C" fn measure(signed: u32) -> u32 {
    VIEW.with_borrow_mut(|view| done(view.measure(signed != 0)))
}

/// Returns the address of the evaluated positions, f32 (n, 3).
#[unsafe(no_mangle)]
pub extern "C" fn positions() -> *const f32 {
    VIEW.with_borrow(|view| view.positions().as_ptr())
}

/// Returns the address of the evaluated normals, f32 (n, 3).
#[unsafe(no_mangle)]
pub extern "C" fn normals() -> *const f32 {
    VIEW.with_borrow(|view| view.normals().as_ptr())
}

/// Returns the address of the measured distances, f32 (n).
#[unsafe(no_mangle)]
pub extern "C" fn distances() -> *const f32 {
    VIEW.with_borrow(|view| view.distances().as_ptr())
}

/// Returns the address of the reference's positions, f32 (n, 3).
#[unsafe(no_mangle)]
pub extern "C" fn reference() -> *const f32 {
    let reference = VIEW.with_borrow(View::reference);
    REFERENCE.with_borrow_mut(|kept| {
        *kept = reference;
        kept.as_ptr()
    })
}
