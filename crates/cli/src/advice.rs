//! What to do about an error of the library, in terms of the flags of this program.
//!
//! The library says what is wrong and carries it in the fields of its errors. Which flag mends it is known here alone; it
//! is appended to the error's line.

use spharm_solver::SolverError;
use spharm_store::StoreError;
use spharm_surface::SurfaceError;

/// What the user can do, of the first error in the chain for which there is something.
pub fn advice(error: &anyhow::Error) -> Option<String> {
    error.chain().find_map(|cause| {
        let surface = cause.downcast_ref().and_then(of_surface);
        let store = || cause.downcast_ref().and_then(of_store);
        let solver = || cause.downcast_ref().and_then(of_solver);
        surface.or_else(store).or_else(solver)
    })
}

fn of_surface(error: &SurfaceError) -> Option<String> {
    match error {
        SurfaceError::OutputExists { .. } => Some("pass --force to replace it, or give another name".to_owned()),
        // Of surfaces that are compared vertex by vertex.
        SurfaceError::TopologyDiffers { .. }
        | SurfaceError::LengthMismatch { what: "triangles of the reconstruction", .. } => {
            Some("--surface-distance compares surfaces with different triangles".to_owned())
        }
        _ => None,
    }
}

fn of_store(_error: &StoreError) -> Option<String> {
    None
}

fn of_solver(error: &SolverError) -> Option<String> {
    match error {
        SolverError::Store(error) => of_store(error),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use anyhow::Context;

    use super::*;

    #[test]
    fn advice_is_found_beneath_the_context() {
        let error = SurfaceError::OutputExists { path: "x.ply".into() };
        let error = Err::<(), _>(error).context("while writing").unwrap_err();
        assert!(advice(&error).is_some_and(|advice| advice.contains("--force")));
        assert_eq!(advice(&anyhow::anyhow!("no flag mends this")), None);
    }
}
