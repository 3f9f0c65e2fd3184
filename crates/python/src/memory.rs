//! Checks that the memory budget suffices for a computation, before memory is allocated.

use spharm::Mesh;
use spharm::machine::available_memory;
use spharm::metrics::{SurfaceDistanceParams, distances_to_surface_bytes, surface_distance_bytes};
use spharm::parametrize::{Method, Sampling, Source};

use crate::errors::Failure;

/// Fails if a computation needs more bytes than the given budget. Without a budget, the free memory is the limit.
fn check(what: String, needed: u64, memory: Option<usize>) -> Result<(), Failure> {
    let budget = memory.unwrap_or_else(available_memory) as u64;
    if needed <= budget { Ok(()) } else { Err(Failure::Memory { what, budget, needed, given: memory.is_some() }) }
}

/// Fails if there is too little memory to map a surface to a sphere.
pub(crate) fn check_mapping<'a>(
    source: impl Into<Source<'a>>,
    method: &Method,
    memory: Option<usize>,
) -> Result<(), Failure> {
    let vertices = source.into().vertices();
    check(format!("mapping {vertices} vertices"), method.bytes(vertices), memory)
}

/// Fails if there is too little memory to resample a surface.
pub(crate) fn check_resampling(shared: &Mesh, memory: Option<usize>) -> Result<(), Failure> {
    let vertices = shared.vertices.len() as u64;
    check(format!("resampling to {vertices} vertices"), Sampling::BYTES_PER_VERTEX.saturating_mul(vertices), memory)
}

/// Fails if there is too little memory to measure the distance between two surfaces.
pub(crate) fn check_distance(
    [first, second]: [&Mesh; 2],
    params: &SurfaceDistanceParams,
    memory: Option<usize>,
) -> Result<(), Failure> {
    let of_vertices = distances_to_surface_bytes(first.faces.len(), second.vertices.len());
    let needed = surface_distance_bytes(first, second, params).max(of_vertices);
    check(format!("computing the distance at {} points of each surface", params.samples), needed, memory)
}
