//! Builds an initial map and then minimises a sequence of energies, starting from this map. All methods for meshes use
//! this code.

use std::time::Instant;

use spharm_monitor::{Interrupted, Monitor, Stage};
use spharm_surface::Mesh;

use crate::domain::Domain;
use crate::embed::{Growth, embed};
use crate::energy::{Energy, set_areas};
use crate::error::ParametrizeError;
use crate::geometry::{Vec3, solid_angle};
use crate::hierarchy::Hierarchy;
use crate::newton::Newton;
use crate::report::Parametrization;
use crate::star::{Classes, sweep};

/// The stage that [`Descent::descend`] reports to the monitor, counted in Newton steps. The number of steps isn't known
/// in advance.
pub(crate) const SMOOTHING: Stage = Stage::counted("smoothing", "steps");

/// If less than this fraction of a Newton step is taken, single vertices probably block the step. A sweep over single
/// vertices then helps more than another Newton step.
const BLOCKED: f64 = 0.2;

/// A map that is being optimised.
pub(crate) struct Descent {
    /// The current map: a unit vector per vertex, such that no triangle is flipped.
    pub(crate) map: Vec<Vec3>,
    iterations: usize,
    converged: bool,
    hierarchy: Hierarchy,
    newton: Option<Newton>,
    classes: Classes,
}

impl Descent {
    /// Builds an initial map from a tetrahedron, coarse to fine.
    pub(crate) fn start(domain: &Domain, growth: Growth, monitor: &dyn Monitor) -> Result<Self, ParametrizeError> {
        let (map, iterations, hierarchy) = embed(&domain.positions, &domain.faces, &domain.areas, growth, monitor)?;
        let newton = Newton::new(map.len(), hierarchy.faces.clone(), hierarchy.shapes.clone(), monitor)?;
        let order: Vec<u32> = (0..map.len() as u32).collect();
        let classes = Classes::new(&hierarchy, &order);
        Ok(Self { map, iterations, converged: false, hierarchy, newton, classes })
    }

    /// Minimises an energy. Stops after `steps` steps, or when another step is estimated to lower the energy by less
    /// than `tolerance` times the amount by which the energy exceeds that of an isometry.
    pub(crate) fn descend(
        &mut self,
        energy: Energy,
        tolerance: f64,
        steps: usize,
        monitor: &dyn Monitor,
    ) -> Result<(), Interrupted> {
        let least = energy.least() * 4.0 * std::f64::consts::PI;
        self.converged = false;
        sweep(&self.hierarchy, &mut self.map, &self.classes, energy, monitor)?;
        let Some(newton) = &mut self.newton else { return Ok(()) };
        for _ in 0..steps {
            let step = newton.step(energy, &mut self.map, monitor)?;
            self.iterations += 1;
            monitor.step(1);
            let mut after = step.after;
            if step.taken < BLOCKED {
                sweep(&self.hierarchy, &mut self.map, &self.classes, energy, monitor)?;
                after = newton.value(energy, &self.map);
            }
            if step.left(step.before - after) <= tolerance * (after - least).abs() {
                self.converged = true;
                break;
            }
        }
        Ok(())
    }

    /// Sets the target area of each triangle; the areas must sum to 4 pi.
    pub(crate) fn set_areas(&mut self, areas: &[f64]) {
        set_areas(&mut self.hierarchy.shapes, areas);
        if let Some(newton) = &mut self.newton {
            newton.set_areas(areas);
        }
    }

    /// Returns the root mean square of the triangles' log area ratios.
    pub(crate) fn area_distortion(&self, domain: &Domain) -> f64 {
        let log = |(face, area): (&[u32; 3], &f64)| {
            let angle = solid_angle(face.map(|v| self.map[v as usize]));
            (angle / area).max(f64::MIN_POSITIVE).ln().powi(2)
        };
        (domain.faces.iter().zip(&domain.areas).map(log).sum::<f64>() / domain.faces.len() as f64).sqrt()
    }

    /// Returns the map and its report, or an error if the map isn't one to one.
    pub(crate) fn finish(
        self,
        method: &'static str,
        surface: &Mesh,
        domain: &Domain,
        started: Instant,
    ) -> Result<Parametrization, ParametrizeError> {
        let sphere = domain.sphere(surface, self.map);
        let remedy = "remesh the surface so that its triangles are less thin";
        let mut found = Parametrization::checked(method, surface.clone(), sphere, started, remedy)?;
        found.report.iterations = self.iterations;
        found.report.converged = self.converged;
        Ok(found)
    }
}
