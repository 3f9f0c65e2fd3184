//! Gives advice on errors of the library, in terms of this program's flags.
//!
//! The library's errors state the problem, and their fields hold its details. Only this module knows which flag
//! remedies an error. The advice is appended to the line with the error message.

mod fit;

use std::io;
use std::path::Path;

use spharm::moments::accumulate;
use spharm::shape::codec::CodecError;
use spharm::shape::even::NO_TRIANGLES;
use spharm::{Error, ModelError, MomentsError, ShapeError, percent_to_allow, percent_to_wrap};
use spharm_cohort::run::RunError;
use spharm_parametrize::wrap::USUAL_VOXELS;
use spharm_parametrize::{Mending, ParametrizeError};
use spharm_solver::SolverError;
use spharm_store::{Scalar, StoreError};
use spharm_surface::SurfaceError;
use spharm_surface::io::to_write_mesh;

pub use fit::of_oscillation;

use crate::output::STDOUT;

/// Returns the advice on `error` or, if there is none, on the first error in its chain of sources that has advice;
/// `None` if there is no advice.
pub fn advice(error: &(dyn std::error::Error + 'static)) -> Option<String> {
    std::iter::successors(Some(error), |&error| error.source()).find_map(|cause| {
        let surface = cause.downcast_ref().and_then(of_surface);
        let store = || cause.downcast_ref().and_then(of_store);
        let solver = || cause.downcast_ref().and_then(of_solver);
        let parametrize = || cause.downcast_ref().and_then(of_parametrize);
        let fit = || cause.downcast_ref().and_then(of_fit);
        let moments = || cause.downcast_ref().and_then(of_moments);
        let model = || cause.downcast_ref().and_then(of_model);
        let shape = || cause.downcast_ref().and_then(of_shape);
        let codec = || cause.downcast_ref().and_then(of_codec);
        let refusal = || cause.downcast_ref().map(fit::of_refusal);
        let run = || cause.downcast_ref().and_then(of_run);
        surface
            .or_else(store)
            .or_else(solver)
            .or_else(parametrize)
            .or_else(fit)
            .or_else(model)
            .or_else(moments)
            .or_else(shape)
            .or_else(codec)
            .or_else(refusal)
            .or_else(run)
    })
}

/// Returns the advice on an error of the crate `spharm`, or on the error of a lower-level crate that it wraps.
fn of_fit(error: &Error) -> Option<String> {
    match error {
        Error::Surface(error) => of_surface(error),
        Error::Store(error) => of_store(error),
        Error::Solver(error) => of_solver(error),
        Error::Parametrize(error) => of_parametrize(error),
        Error::Model(error) => of_model(error),
        Error::Shape(error) => of_shape(error),
        Error::Member { source, .. } => of_fit(source),
        error => fit::of_fit(error),
    }
}

fn of_run(error: &RunError) -> Option<String> {
    match error {
        RunError::Fit(error) => of_fit(error),
        RunError::Of { source, .. } => of_run(source),
        RunError::Output(refusal) => Some(fit::of_refusal(refusal)),
        RunError::AreaOfLabel { .. } => Some("omit --area".to_owned()),
        _ => None,
    }
}

fn of_surface(error: &SurfaceError) -> Option<String> {
    match error {
        SurfaceError::OutputExists { .. } => {
            Some("give --force to replace the file, or choose another name".to_owned())
        }
        SurfaceError::VolumeInput { .. } => {
            Some("spharm fit and spharm parametrize accept volumes, with --label N and without --sphere".to_owned())
        }
        SurfaceError::NotAMesh { .. } => Some("spharm fit accepts values together with --sphere".to_owned()),
        SurfaceError::Io { path, cause, .. } => of_missing(path, cause),
        // These errors occur when two surfaces are compared vertex by vertex.
        SurfaceError::TopologyDiffers { .. }
        | SurfaceError::LengthMismatch { what: "triangles of the reconstruction", .. } => {
            Some("--surface-distance compares surfaces with different triangles".to_owned())
        }
        _ => None,
    }
}

/// Returns the advice on a missing file named `-`. Many other programs use this name for standard input.
fn of_missing(path: &Path, cause: &io::Error) -> Option<String> {
    let is_stdin = path == Path::new(STDOUT) && cause.kind() == io::ErrorKind::NotFound;
    is_stdin.then(|| "standard input isn't supported for this file; give the path of a file".to_owned())
}

fn of_store(error: &StoreError) -> Option<String> {
    let text = match error {
        StoreError::Io { source, .. } => return of_io(source).map(str::to_owned),
        StoreError::FactorDiffers { .. } => {
            "compute the required Cholesky factor with spharm basis-build --factor".to_owned()
        }
        StoreError::FactorMissing { .. } => {
            "compute the Cholesky factor for the same sphere with spharm basis-build --factor".to_owned()
        }
        StoreError::NoSuchScheme { .. } => {
            "build the basis for the same sphere with spharm basis-build --sphere".to_owned()
        }
        StoreError::OtherScalar { wanted, found, .. } => {
            let (wanted, found) = (wanted.name(), found.name());
            format!("give --dtype {found}, or build the basis with spharm basis-build --dtype {wanted}")
        }
        StoreError::Budget { .. } => "give a larger budget with --memory".to_owned(),
        StoreError::NoSchemes { .. } => "was this folder given to spharm basis-build as --store?".to_owned(),
        StoreError::KeyDigits { found: 0, .. } => "`spharm store list` shows the keys of all schemes".to_owned(),
        StoreError::KeyDigits { .. } => "give more digits of the key".to_owned(),
        StoreError::DegreeMissing { store, scalar, wanted, .. } => {
            let dtype = if *scalar == Some(Scalar::F32) { " --dtype f32" } else { "" };
            let store = store.display();
            format!(
                "extend the basis with: spharm basis-build --sphere SPHERE --max-degree {wanted} --store {store}{dtype}"
            )
        }
        StoreError::Space { what, needed, free, .. } => of_space(what, needed > free),
        StoreError::Layout { .. } => "choose another value for --chunk-rows".to_owned(),
        StoreError::NotAFile { .. }
        | StoreError::Corrupt { .. }
        | StoreError::ChunkDamaged { .. }
        | StoreError::TileDamaged { .. }
        | StoreError::ChangedWhileRead { .. }
        | StoreError::ChunkRowsDiffer { .. } => "spharm basis-build rebuilds missing files".to_owned(),
        StoreError::Interrupted(_) => "run the same command again to resume".to_owned(),
        _ => return None,
    };
    Some(text)
}

fn of_space(what: &str, too_large: bool) -> String {
    let (degree, dtype) = match what {
        "factor" => ("a lower degree", "--factor-dtype f32"),
        _ => ("a lower --max-degree", "--dtype f32"),
    };
    if too_large {
        format!("choose a --store with more free space, {degree} or {dtype}, or continue anyway with --yes")
    } else {
        format!("continue with --yes, or choose {degree} or {dtype}")
    }
}

fn of_io(source: &io::Error) -> Option<&'static str> {
    match source.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => Some(
            "free some space or choose another --store, then run the same command again: finished degrees are kept",
        ),
        io::ErrorKind::ReadOnlyFilesystem | io::ErrorKind::PermissionDenied => {
            Some("choose a --store that you have permission to use, or change its permissions")
        }
        io::ErrorKind::NotFound => Some("check the path, or build the store with spharm basis-build"),
        #[cfg(unix)]
        _ if source.raw_os_error() == Some(libc::EMFILE) => Some("raise the limit on open files (ulimit -n)"),
        _ => None,
    }
}

fn of_solver(error: &SolverError) -> Option<String> {
    match error {
        SolverError::Store(error) => of_store(error),
        SolverError::Budget { granularity: Some(granularity), .. } => {
            Some(format!("--method irf --granularity {granularity} fits into the budget"))
        }
        SolverError::Budget { granularity: None, .. } => Some("give a larger budget with --memory".to_owned()),
        SolverError::Singular { needed, .. } => {
            let memory = needed.div_ceil(1 << 20);
            Some(format!("give --memory {memory}MiB, or use --method irf with a smaller --granularity"))
        }
        SolverError::Underdetermined { .. } => {
            Some("set a lower degree with --max-degree L, or a penalty with --smoothness LAMBDA".to_owned())
        }
        SolverError::UnderdeterminedWithPenalty { needed, .. } => {
            Some(format!("set a {needed} penalty with --smoothness LAMBDA"))
        }
        // Only the computation of a factor for a store returns this error; a fit uses a shifted factor instead of
        // failing.
        SolverError::NotPositiveDefinite { .. } => {
            Some("set a lower degree with --factor L, or a penalty with --smoothness LAMBDA".to_owned())
        }
        SolverError::Interrupted(_) => {
            Some("finished models are kept, and --skip-existing skips them next time".to_owned())
        }
        _ => None,
    }
}

fn of_parametrize(error: &ParametrizeError) -> Option<String> {
    match error {
        ParametrizeError::BadSurface { mending: Some(mending), .. } => Some(of_mending(mending)),
        ParametrizeError::BadSurface { handles: 1.., .. } => Some(
            "use --cut-handles to cut the handles and fill the cuts; spharm reconstruct restores the handles"
                .to_owned(),
        ),
        ParametrizeError::BadSurface { mending: None, .. } | ParametrizeError::OneSided { closed: true } => {
            Some(of_wrap())
        }
        ParametrizeError::LargeRepair { repair, succeeds, wraps, .. } => {
            let percent = percent_to_allow(repair).filter(|_| *succeeds);
            let allow = percent.map(|percent| format!("--largest-repair {percent} allows this repair"));
            let advice: Vec<String> = wraps.then(of_wrap).into_iter().chain(allow).collect();
            (!advice.is_empty()).then(|| advice.join("; alternatively, "))
        }
        ParametrizeError::LossyWrap { wrap, .. } => {
            Some(format!("--largest-repair {} allows this wrap", percent_to_wrap(wrap)))
        }
        ParametrizeError::BadVolume { repairable: true, handles: 1.., .. } => {
            Some("--fix repairs the label; to keep its handles, use --cut-handles".to_owned())
        }
        ParametrizeError::BadVolume { repairable: true, .. } => Some("--fix repairs the label".to_owned()),
        ParametrizeError::VertexMap { .. } => {
            Some("spharm fit accepts values on vertices together with the --sphere of these vertices".to_owned())
        }
        ParametrizeError::NotLabels { value, .. } if value.fract() == 0.0 => {
            Some(format!("renumber labels above {}; use --threshold LEVEL for grey values", i32::MAX))
        }
        ParametrizeError::NotLabels { .. } => {
            Some("use --threshold LEVEL for grey values, or --probability for probabilities".to_owned())
        }
        ParametrizeError::SeveralImages { channels, times, chosen, .. } => Some(match (channels, times) {
            (1, 1) => "omit --channel and --time".to_owned(),
            (1, times) => {
                let omit = if chosen.channel.is_some() { ", and omit --channel" } else { "" };
                format!("give --time N from 1 to {times}{omit}")
            }
            (channels, 1) => {
                let omit = if chosen.time.is_some() { ", and omit --time" } else { "" };
                format!("give --channel N from 1 to {channels}{omit}")
            }
            (channels, times) => format!("give --channel N from 1 to {channels} and --time N from 1 to {times}"),
        }),
        ParametrizeError::NoVoxelSize { .. } => Some("give the voxel size with --voxel-size X,Y,Z".to_owned()),
        ParametrizeError::FixedAxes { .. } => Some("omit --axes; it is for NumPy files".to_owned()),
        ParametrizeError::NotProbability { .. } => Some("use --threshold LEVEL for values of any range".to_owned()),
        ParametrizeError::NoLabel { .. } => Some("choose a label with --label N".to_owned()),
        ParametrizeError::SinglePrecision { .. } => {
            Some("files ending in .surf.gii or .ply store 64-bit numbers".to_owned())
        }
        ParametrizeError::Surface(error) => of_surface(error),
        ParametrizeError::Solver(error) => of_solver(error),
        _ => None,
    }
}

/// Returns the advice for a mesh that a repair can't close: to replace it by a wrap.
fn of_wrap() -> String {
    format!("--wrap {USUAL_VOXELS} replaces the mesh by the closed surface around it")
}

/// Returns the advice for a mesh that can be repaired: the flags that allow the necessary repairs.
fn of_mending(mending: &Mending) -> String {
    let large = percent_to_allow(&mending.repair).map(|percent| format!(" --largest-repair {percent}"));
    let cut = if mending.handles > 0 { " --cut-handles" } else { "" };
    let fix = format!("give --fix{}{cut}", large.unwrap_or_default());
    if mending.wraps { format!("{}; alternatively, {fix}", of_wrap()) } else { fix }
}

fn of_moments(error: &MomentsError) -> Option<String> {
    match error {
        MomentsError::Columns { .. } => Some(
            "give the position columns with --angles, --lonlat or --vectors, and the value columns with --values"
                .to_owned(),
        ),
        // The chunks of rows alone exceed the budget at any degree, so a lower degree wouldn't help.
        MomentsError::Memory { budget, .. } if *budget < accumulate::bytes(0, 1) => {
            Some("set a larger budget with --memory SIZE".to_owned())
        }
        MomentsError::Memory { .. } => {
            Some("set a lower degree with --max-degree L, or a larger budget with --memory SIZE".to_owned())
        }
        MomentsError::Missing { .. } => Some("to add only the parts that exist, give --partial".to_owned()),
        MomentsError::Output(error) => of_surface(error),
        _ => None,
    }
}

fn of_model(error: &ModelError) -> Option<String> {
    match error {
        ModelError::NoSphere => Some("give a sphere with --icosphere N or --sphere FILE".to_owned()),
        ModelError::Surface(error) => of_surface(error),
        ModelError::Input { path, source } | ModelError::Open { path, source } => of_missing(path, source),
        ModelError::Compressed { path } => {
            Some(format!("restore the model with `spharm shape expand {} -o NAME.spharm.npz`", path.display()))
        }
        ModelError::Invalid { path, .. } if to_write_mesh(path).is_ok() => {
            let path = path.display();
            Some(format!("this file is a mesh; make a model with `spharm fit --surface {path} --max-degree L`"))
        }
        _ => None,
    }
}

fn of_shape(error: &ShapeError) -> Option<String> {
    match error {
        ShapeError::NotASurface { .. } => Some("spharm shape smooth and describe also accept signals".to_owned()),
        ShapeError::NoExtent { .. } => {
            Some("`spharm reconstruct` shows the model; fit the surface again with degree 1 or more".to_owned())
        }
        ShapeError::NotTwoGroups => Some(
            "for other designs, except tests of positions, give --variance-groups COLUMN, or variance_groups in a study"
                .to_owned(),
        ),
        ShapeError::Range { .. } => Some("`spharm shape rotate --scale FACTOR` scales a model".to_owned()),
        ShapeError::Setting { name: NO_TRIANGLES, .. } => {
            Some("give --icosphere N, or a --sphere with triangles".to_owned())
        }
        _ => None,
    }
}

fn of_codec(error: &CodecError) -> Option<String> {
    match error {
        CodecError::CutOff { level: Some(_), .. } => Some("give --prefix to read this model".to_owned()),
        CodecError::Shape(error) => of_shape(error),
        CodecError::Surface(error) => of_surface(error),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use anyhow::Context;

    use super::*;
    use crate::exit::line_with_advice;

    #[test]
    fn moments_need_a_larger_budget_whatever_the_degree() {
        let of = |budget| of_moments(&MomentsError::Memory { max_degree: 1, needed: 95 << 20, budget }).unwrap();
        assert!(!of(1 << 20).contains("--max-degree") && of(1 << 20).contains("--memory"));
        assert!(of(accumulate::bytes(0, 1)).contains("--max-degree"));
    }

    #[test]
    fn undetermined_standard_errors_need_another_penalty() {
        for needed in ["smaller", "larger"] {
            let error = SolverError::UnderdeterminedWithPenalty { rows: 12, columns: 25, needed };
            let expected = format!("set a {needed} penalty with --smoothness LAMBDA");
            assert_eq!(advice(&Error::from(error)), Some(expected));
        }
    }

    #[test]
    fn large_labels_are_to_be_renumbered() {
        let of = |value| {
            let error = ParametrizeError::NotLabels { path: "a.nii".into(), value, voxel: 3 };
            advice(&Error::from(error)).unwrap()
        };
        assert!(of(8_589_934_593.0).contains("renumber labels above 2147483647"), "{}", of(8_589_934_593.0));
        assert!(!of(0.5).contains("renumber") && of(0.5).contains("--probability"), "{}", of(0.5));
    }

    #[test]
    fn standard_input_is_named_where_it_is_not_supported() {
        let missing = |path: &str| {
            let cause = io::Error::from(io::ErrorKind::NotFound);
            of_surface(&SurfaceError::Io { path: path.into(), action: "open", cause })
        };
        assert!(missing("-").is_some_and(|advice| advice.contains("standard input")));
        assert_eq!(missing("x.ply"), None);
    }

    #[test]
    fn advice_is_found_beneath_the_context() {
        let error = SurfaceError::OutputExists { path: "x.ply".into() };
        let error = Err::<(), _>(error).context("while writing").unwrap_err();
        assert!(advice(error.as_ref()).is_some_and(|advice| advice.contains("--force")));
        assert_eq!(advice(anyhow::anyhow!("no flag mends this").as_ref()), None);
        let one_sided = |closed| advice(&ParametrizeError::OneSided { closed });
        assert!(one_sided(true).is_some_and(|advice| advice.contains("--wrap")) && one_sided(false).is_none());
        assert!(advice(&ShapeError::NotTwoGroups).is_some_and(|advice| advice.contains("--variance-groups COLUMN")));
        let memory = || RunError::from(Error::Memory { budget: 1 << 20, needed: 2 << 20 });
        for error in [memory(), memory().of("a row").of("its file")] {
            assert!(advice(&error).is_some_and(|advice| advice.contains("--memory")));
            assert!(line_with_advice(&error).contains("2MiB"), "{error}");
        }
        let member = Error::Member { index: 1, source: Box::new(Error::Memory { budget: 1, needed: 3 << 20 }) };
        assert!(advice(&member).is_some_and(|advice| advice.contains("--memory")));
        assert!(line_with_advice(&member).contains("3MiB"), "{member}");
        let line = line_with_advice(&ModelError::NoSphere);
        assert_eq!(line, "the model has no sphere of its own; give a sphere with --icosphere N or --sphere FILE");
    }
}
