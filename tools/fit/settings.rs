//! Converts the arguments of `fit` to the library's settings. Conflicting arguments are usage errors.

use std::path::PathBuf;

use anyhow::Result;
use clap::ValueEnum;
use spharm::{FitParams, Method, Objective, Preconditioner, Weights, defaults};
use spharm_cli::Usage;
use spharm_cli::values::Dtype;
use spharm_store::catalog::schemes;

use super::args::{Cli, MethodName};

/// Returns the settings given by the arguments. If no degree is given, the degree is 0, and the fit chooses one.
pub(super) fn params(cli: &Cli) -> Result<FitParams> {
    let degree = match cli.method.max_degree {
        Some(degree) => degree,
        None => {
            let input = &cli.input;
            let needs = [
                (input.store.is_some(), "--store", "at most the degree of the basis"),
                (input.moments.is_some(), "--moments", "at most the degree of the moments"),
                (cli.cohort.shard.is_some(), "--shard", "the same degree for all shards"),
                (cli.method.method.is_some_and(|method| method != MethodName::Lsq), "--method", "there is no default"),
                (cli.method.objective == Some(Objective::Vertices), "--objective vertices", "there is no default"),
            ];
            if let Some((_, flag, which)) = needs.into_iter().find(|(given, ..)| *given) {
                return Err(Usage::missing(format!("{flag} needs --max-degree L ({which})")).into());
            }
            0
        }
    };
    let weights = match cli.input.weights.as_str() {
        "uniform" => Weights::Uniform,
        "area" => Weights::Area,
        file => Weights::read(file)?,
    };
    let (name, store) = method_and_store(cli);
    let method = method(cli, name, store.is_some())?;
    // Check the store's path before any surface is read, even if the method doesn't use the store.
    store.as_deref().map(schemes).transpose()?;
    let params = FitParams::lsq(degree)
        .with_method(method)
        .with_objective(cli.method.objective.unwrap_or_default())
        .with_area(cli.method.area)
        .with_smoothness(cli.method.smoothness.unwrap_or_default())
        .with_denoise(cli.method.denoise)
        .with_weights(weights)
        .with_hold_out(cli.method.hold_out)
        .with_surface_distance(!cli.method.no_surface_distance)
        .with_standard_errors(cli.output.stderr)
        .with_tolerance(cli.solver.tolerance)
        .with_max_iterations(cli.solver.max_iterations)
        .with_preconditioner(cli.solver.preconditioner)
        .with_strict(cli.input.strict)
        .with_store(store)
        .with_scalar(cli.solver.dtype.map(Dtype::scalar))
        .with_verify(cli.solver.verify)
        .with_memory(cli.resources.memory.map(|size| size.0))
        .with_threads(cli.resources.threads.count());
    params.check()?;
    Ok(params)
}

/// Returns the method, and the folder of the store. The environment variable SPHARM_STORE gives the folder only for a
/// method that needs a store. The variable never changes the method or the objective.
fn method_and_store(cli: &Cli) -> (MethodName, Option<PathBuf>) {
    let given = cli.input.store.clone();
    let method = cli.method.method.unwrap_or(if given.is_some() { MethodName::Irf } else { MethodName::Lsq });
    let of_environment = || std::env::var_os("SPHARM_STORE").filter(|store| !store.is_empty()).map(PathBuf::from);
    (method, if method.is_streamed() { given.or_else(of_environment) } else { given })
}

fn method(cli: &Cli, method: MethodName, store: bool) -> Result<Method, Usage> {
    use MethodName::{Irf, Lsq, Mirf, Nlsf, Quadrature, Sirf};
    let args = &cli.method;
    let name = method.to_possible_value().map_or(String::new(), |value| value.get_name().to_owned());
    let streamed = method.is_streamed();
    let needs = [
        (!store, "--store DIR, with a basis made by spharm basis-build"),
        (
            cli.input.sphere.is_none() && cli.input.manifest.is_none(),
            "--sphere SPHERE, the sphere for which the basis was built",
        ),
    ];
    if let Some((_, needed)) = needs.iter().find(|(missing, _)| streamed && *missing) {
        return Err(Usage::missing(format!("--method {name} needs {needed}")));
    }
    let repeated = matches!(method, Irf | Mirf);
    let by_factor = cli.solver.preconditioner != Preconditioner::Auto;
    let (tolerance, most) = (cli.solver.tolerance, cli.solver.max_iterations);
    let weighted = cli.input.weights != "uniform" || args.hold_out.is_some();
    let of_surface_in_store = args.objective == Some(Objective::Surface) && store;
    let of_basis = cli.solver.dtype.is_some() || cli.solver.verify;
    let conflicts = [
        (args.start_degree.is_some() && !matches!(method, Sirf | Mirf), "--start-degree", ""),
        (args.granularity.is_some() && method != Irf, "--granularity", ""),
        (args.passes.is_some_and(|p| p > 1) && !repeated, "--passes", "; for several passes use --method mirf"),
        (args.accelerate && !repeated, "--accelerate", "; use --method irf or mirf"),
        (args.objective == Some(Objective::Surface) && method != Lsq, "--objective surface", "; use --method lsq"),
        (
            of_surface_in_store,
            "--objective surface",
            " and --store, because the basis and the factor in a store are for vertices",
        ),
        (args.smoothness.is_some() && method != Lsq, "--smoothness", "; use --method lsq"),
        (args.denoise && method != Lsq, "--denoise", "; use --method lsq"),
        (cli.output.stderr && method != Lsq, "--stderr", "; use --method lsq"),
        (by_factor && method != Lsq, "--preconditioner", "; use --method lsq"),
        (tolerance != defaults::TOLERANCE && method != Lsq, "--tolerance", "; use --method lsq"),
        (most != defaults::MAX_ITERATIONS && method != Lsq, "--max-iterations", "; use --method lsq"),
        (weighted && method == Quadrature, "--weights and --hold-out", ""),
        (of_basis && !streamed, "--dtype and --verify", ", because this method doesn't use a basis store"),
    ];
    if let Some((_, flag, hint)) = conflicts.into_iter().find(|(conflict, ..)| *conflict) {
        return Err(Usage::conflict(format!("{flag} cannot be used with --method {name}{hint}")));
    }
    let accelerate = args.accelerate;
    let usual = match method {
        _ if accelerate => defaults::ACCELERATED_PASSES,
        Mirf => Method::mirf().passes(),
        _ => 1,
    };
    let passes = args.passes.map_or(usual, |p| p as usize);
    let granularity = args.granularity.unwrap_or(defaults::GRANULARITY);
    let start_degree = args.start_degree.unwrap_or(0);
    Ok(match method {
        Lsq => Method::Lsq,
        Quadrature => Method::Quadrature,
        Irf => Method::Irf { passes, granularity, accelerate },
        Sirf => Method::Sirf { start_degree },
        Mirf => Method::Mirf { passes, start_degree, accelerate },
        Nlsf => Method::Nlsf,
    })
}
