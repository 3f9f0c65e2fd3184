//! From a mesh to a map by a list of energies: what the methods for meshes share.

use crate::domain::Domain;
use crate::embed::{Growth, embed};
use crate::energy::Energy;
use crate::error::ParametrizeError;
use crate::geometry::Vec3;
use crate::hierarchy::Hierarchy;
use crate::newton::Newton;
use crate::star::sweep;
use crate::{Event, Progress};

/// Below this share of Newton's step single vertices are in the way, and a sweep over them helps more than another step.
const BLOCKED: f64 = 0.2;

/// A map on its way.
pub(crate) struct Descent {
    /// Unit vectors, one a vertex; no triangle is flipped.
    pub(crate) map: Vec<Vec3>,
    /// Newton's steps so far.
    pub(crate) iterations: usize,
    /// Whether the last stage came to rest.
    pub(crate) converged: bool,
    hierarchy: Hierarchy,
    newton: Option<Newton>,
    order: Vec<u32>,
}

impl Descent {
    /// Grows a map from a tetrahedron.
    pub(crate) fn start(domain: &Domain, growth: Growth, progress: Progress<'_>) -> Result<Self, ParametrizeError> {
        let (map, iterations, hierarchy) = embed(&domain.positions, &domain.faces, growth, progress)?;
        let newton = Newton::new(map.len(), hierarchy.faces.clone(), hierarchy.shapes.clone());
        let order = (0..map.len() as u32).collect();
        Ok(Self { map, iterations, converged: false, hierarchy, newton, order })
    }

    /// Descends an energy until a step gains less than `tolerance` of what the energy is above its least value on a
    /// smooth surface, or `steps` steps are done.
    pub(crate) fn descend(&mut self, energy: Energy, tolerance: f64, steps: usize, progress: Progress<'_>) {
        let least = energy.least() * 4.0 * std::f64::consts::PI;
        self.converged = false;
        sweep(&self.hierarchy, &mut self.map, &self.order, energy);
        let Some(newton) = &self.newton else { return };
        for done in 0..steps {
            let step = newton.step(energy, &mut self.map);
            if std::env::var_os("TRACE").is_some() {
                eprintln!("{energy:?} {done} {step:?}");
            }
            self.iterations += 1;
            progress(Event::Step(1));
            let mut after = step.after;
            if step.taken < BLOCKED {
                sweep(&self.hierarchy, &mut self.map, &self.order, energy);
                after = newton.value(energy, &self.map);
            }
            if step.before - after <= tolerance * (after - least).abs() {
                self.converged = true;
                progress(Event::Step((steps - done - 1) as u64));
                return;
            }
        }
    }
}
