//! From a mesh to a map by a list of energies: what the methods for meshes share.

use crate::domain::Domain;
use crate::embed::{Growth, embed};
use crate::energy::{Energy, set_areas};
use crate::error::ParametrizeError;
use crate::geometry::{Vec3, solid_angle};
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
        let (map, iterations, hierarchy) = embed(&domain.positions, &domain.faces, &domain.areas, growth, progress)?;
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

    /// From now on triangles are to have these areas, 4 pi in all.
    pub(crate) fn set_areas(&mut self, areas: &[f64]) {
        set_areas(&mut self.hierarchy.shapes, areas);
        if let Some(newton) = &mut self.newton {
            newton.set_areas(areas);
        }
    }

    /// Root mean square over triangles of the log area ratio.
    pub(crate) fn area_distortion(&self, domain: &Domain) -> f64 {
        let log = |(face, area): (&[u32; 3], &f64)| {
            let angle = solid_angle(face.map(|v| self.map[v as usize]));
            (angle / area).max(f64::MIN_POSITIVE).ln().powi(2)
        };
        (domain.faces.iter().zip(&domain.areas).map(log).sum::<f64>() / domain.faces.len() as f64).sqrt()
    }
}
