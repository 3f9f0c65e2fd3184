//! What a refinement guarantees.

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::index::basis_size;
use spharm_monitor::Silent;
use spharm_surface::Sphere;
use spharm_surface::geometry::{Vec3, dot, orientation, sub};

use super::field::{field, step};
use super::member::{Member, Plan};
use super::objective::Objective;
use super::state::Group;
use super::*;

/// Ellipsoids with a dent whose place depends on the member.
fn members(count: usize, max_degree: usize) -> Vec<Array2<f64>> {
    let member = |i: usize| {
        let mut values = Array2::from_shape_fn((basis_size(max_degree), 3), |(k, c)| {
            let l = (k as f64).sqrt().floor();
            ((5 * k + 3 * c) as f64 + 0.4 * i as f64).sin() / (1.0 + l * l * l)
        });
        (values[[3, 0]], values[[1, 1]], values[[2, 2]]) = (8.0 + 0.3 * i as f64, 5.0, 4.0);
        values
    };
    (0..count).map(member).collect()
}

fn views(members: &[Array2<f64>]) -> Vec<ArrayView2<'_, f64>> {
    members.iter().map(|member| member.view()).collect()
}

fn stages(max_degree: usize, field_degree: usize, rounds: usize) -> GroupwiseParams {
    let stage = StageParams { max_degree, field_degree, rounds };
    GroupwiseParams { stages: Some(vec![stage]), ..GroupwiseParams::default() }
}

/// The objective along a field is what the gradient says, with weights that follow the surfaces, a mask, normals, and the
/// elastic energy of maps that aren't the identity.
#[test]
fn the_gradient_is_that_of_the_objective() {
    let sphere = Sphere::icosphere(2);
    let directions = sphere.directions.as_slice();
    let mask: Vec<f64> = directions.iter().map(|u| if u[2] > 0.8 { 0.0 } else { 1.0 + u[0] }).collect();
    let channels = with_normals(&views(&members(4, 5)), 0.2, &Silent).unwrap();
    let group = Group {
        members: channels.iter().map(|channels| Member::new(channels.view(), 4).unwrap()).collect(),
        channels: 6,
        objective: Objective { faces: &sphere.faces, mask: &mask },
        elastic: Elastic::new(&sphere.faces, directions),
        elasticity: 0.3,
        turning: None,
        max_degree: 4,
        field_degree: 3,
    };
    let potentials = |seed: f64, size: f64| -> Array2<f64> {
        let wave = |(k, c): (usize, usize)| if k == 0 { 0.0 } else { size * (seed + (7 * k + 4 * c) as f64).sin() };
        Array2::from_shape_fn((16, 2), wave)
    };
    let moved = |at: &[Vec<Vec3>], of: &dyn Fn(usize) -> Array2<f64>, t: f64| -> Vec<Vec<Vec3>> {
        let along = |(i, at): (usize, &Vec<Vec3>)| {
            let plan = Plan::new(at, 3, 3).unwrap();
            step(at, &field(&of(i), at, &plan.field).unwrap(), t)
        };
        at.iter().enumerate().map(along).collect()
    };
    let start = moved(&vec![directions.to_vec(); 4], &|i| potentials(i as f64, 0.04), 1.0);
    let state = group.state(start.clone(), |_| 0.5, &Vec::new()).unwrap().unwrap();
    let gradient = group.gradient(&state).unwrap();
    for seed in [1.0, 2.0] {
        let direction = |i: usize| potentials(seed * 10.0 + i as f64, 0.1);
        let expected: f64 =
            (0..4).map(|i| direction(i).iter().zip(&gradient[32 * i..]).map(|(d, g)| d * g).sum::<f64>()).sum();
        let cost = |t: f64| group.state(moved(&start, &direction, t), |_| 0.5, &Vec::new()).unwrap().unwrap().cost;
        let difference = (cost(1e-3) - cost(-1e-3)) / 2e-3;
        let off = (difference - expected).abs();
        assert!(off < 2e-4 * expected.abs() && expected.abs() > 1e-3, "{difference} {expected}");
    }
}

#[test]
fn the_objective_falls_no_triangle_turns_over_and_flows_are_inverted() {
    let sphere = Sphere::icosphere(3);
    let directions = sphere.directions.as_slice();
    let members = members(5, 6);
    let found = groupwise(&views(&members), &sphere, None, &stages(6, 5, 12), &Silent).unwrap();
    let [stage] = found.report.stages[..] else { panic!("one stage") };
    assert!(stage.cost[1] < stage.cost[0] - 0.1 && stage.variance[1] < stage.variance[0], "{stage:?}");
    assert!(stage.steps > 0 && found.flows.iter().all(|flow| flow.steps().len() == stage.steps));
    for (flow, moved) in found.flows.iter().zip(&found.report.moved) {
        let at = flow.apply(directions).unwrap();
        assert!(sphere.faces.iter().all(|face| orientation(face.map(|v| at[v as usize])) > 0.0));
        assert!(*moved > 1e-3);
        let back = flow.inverse(&at).unwrap();
        let off = back.iter().zip(directions).map(|(a, b)| dot(sub(*a, *b), sub(*a, *b)).sqrt()).fold(0.0, f64::max);
        assert!(off < 1e-9, "{off:e}");
        assert_eq!(&Flow::from_steps(flow.steps().to_vec()).unwrap(), flow);
    }
}

#[test]
fn bits_are_the_same_on_any_number_of_threads() {
    let (members, sphere) = (members(4, 5), Sphere::icosphere(2));
    let params = GroupwiseParams { together: true, ..stages(5, 4, 4) };
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| groupwise(&views(&members), &sphere, None, &params, &Silent).unwrap())
    };
    assert_eq!(on(1), on(2));
}

#[test]
fn members_that_are_equal_stay_where_they_are() {
    let one = members(1, 5).remove(0);
    let members = vec![one; 3];
    let params = GroupwiseParams { elasticity: 0.0, ..stages(5, 4, 5) };
    let found = groupwise(&views(&members), &Sphere::icosphere(2), None, &params, &Silent).unwrap();
    assert!(found.report.moved.iter().all(|moved| *moved < 1e-6), "{:?}", found.report.moved);
}
