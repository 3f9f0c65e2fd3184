//! Tests of the groupwise refinement.

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::index::basis_size;
use spharm_monitor::Silent;
use spharm_surface::geometry::{Vec3, dot, orientation, sub};
use spharm_surface::{Place, Sphere};

use super::field::{field, step};
use super::member::{Member, Plan};
use super::objective::Objective;
use super::state::Group;
use super::*;
use crate::{Rotation, rotate_parameters};

/// Returns ellipsoids with a dent whose position depends on the member.
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

/// The gradient equals the rate of change of the objective along a field. The test includes weights that follow the
/// surfaces, a mask, normals, and the elastic energy of maps other than the identity.
#[test]
fn the_gradient_is_that_of_the_objective() {
    let sphere = Sphere::icosphere(2);
    let directions = sphere.directions.as_slice();
    let mask: Vec<f64> = directions.iter().map(|u| if u[2] > 0.8 { 0.0 } else { 1.0 + u[0] }).collect();
    let held = [Place { corners: sphere.faces[7], shares: [0.2, 0.5, 0.3] }];
    let channels = with_normals(&views(&members(4, 5)), 0.2, None, &Silent).unwrap().0;
    let group = Group {
        members: channels.iter().map(|channels| Member::new(channels.view(), 4).unwrap()).collect(),
        channels: 6,
        objective: Objective { faces: &sphere.faces, mask: &mask },
        reference: None,
        elastic: Elastic::new(&sphere.faces, directions),
        elasticity: 0.3,
        held: Held::new(&held, directions, 20.0),
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

/// The sphere of the new member is rotated about an axis. The refinement rotates the sphere back as far as the elastic
/// energy allows.
#[test]
fn a_new_member_comes_to_the_places_of_the_group() {
    let sphere = Sphere::icosphere(3);
    let mut group = members(8, 6);
    let own = group.remove(4);
    let turn = Rotation::from_axis_angle([0.2, -0.4, 0.9], 0.12).unwrap();
    let turned = rotate_parameters(&Coefficients::new(own.clone()).unwrap(), &turn, &Silent).unwrap();
    let settings = GroupwiseParams { elasticity: 0.01, ..stages(6, 5, 40) };
    let finished = FinishedGroup::new(&views(&group), &sphere, None, &settings, &Silent).unwrap();
    let (flow, report) = finished.refine(turned.values().view(), &Silent).unwrap();
    let [stage] = report.stages[..] else { panic!("one stage") };
    assert!(stage.cost[1] < 0.5 * stage.cost[0], "{stage:?}");
    let at = flow.apply(sphere.directions.as_slice()).unwrap();
    let places = |of: ArrayView2<'_, f64>, at: &[Vec3]| {
        Member::new(of, 6).unwrap().values(&Plan::new(at, 6, 1).unwrap()).unwrap()
    };
    let truth = places(own.view(), sphere.directions.as_slice());
    let off = |at: &[Vec3]| (places(turned.values().view(), at) - &truth).mapv(|x| x * x).sum().sqrt();
    let (before, after) = (off(sphere.directions.as_slice()), off(&at));
    assert!(after < 0.4 * before, "{before} {after}");
    // A member that already corresponds moves much less than the rotated member.
    let (_, still) = finished.refine(own.view(), &Silent).unwrap();
    assert!(still.moved[0] < 0.4 * report.moved[0], "{} {}", still.moved[0], report.moved[0]);
    assert!(matches!(finished.refine(group[0].slice(s![..4, ..]), &Silent), Err(ShapeError::Differ { .. })));
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
    let [one, other] = members(2, 5).try_into().unwrap();
    let params = GroupwiseParams { elasticity: 0.0, ..stages(5, 4, 5) };
    let sphere = Sphere::icosphere(2);
    // For two identical members the mean is exact and the variance is 0.
    for count in [2, 3] {
        let members = vec![one.clone(); count];
        let found = groupwise(&views(&members), &sphere, None, &params, &Silent).unwrap();
        assert!(found.report.moved.iter().all(|moved| *moved < 1e-6), "{:?}", found.report.moved);
        let finished = FinishedGroup::new(&views(&members), &sphere, None, &params, &Silent).unwrap();
        let (_, report) = finished.refine(one.view(), &Silent).unwrap();
        assert!(report.moved[0] < 1e-6, "{report:?}");
        let (_, report) = finished.refine(other.view(), &Silent).unwrap();
        assert!(report.stages[0].cost.iter().all(|cost| cost.is_finite()), "{report:?}");
    }
}

/// Returns the fraction of the variance of members' positions at the directions `at` that belongs to the largest
/// eigenvalue of their covariance, by power iteration.
fn first_share(members: &[Array2<f64>], sphere: &Sphere, at: &[Vec<Vec3>]) -> f64 {
    let directions = sphere.directions.len();
    let mut values = Array2::zeros((members.len(), 3 * directions));
    for ((mut row, member), at) in values.rows_mut().into_iter().zip(members).zip(at) {
        let found = Member::new(member.view(), 8).unwrap().values(&Plan::new(at, 8, 1).unwrap()).unwrap();
        row.iter_mut().zip(found.iter()).for_each(|(out, x)| *out = *x);
    }
    let objective = Objective { faces: &sphere.faces, mask: &vec![1.0; directions] };
    let covariance = objective.covariance(values).unwrap();
    let (mut v, mut largest) = (vec![1.0, 0.3, -0.2, 0.1, -0.9], 0.0);
    for _ in 0..200 {
        let next: Vec<f64> =
            covariance.gram.rows().into_iter().map(|row| row.iter().zip(&v).map(|(g, v)| g * v).sum()).collect();
        largest = next.iter().map(|x| x * x).sum::<f64>().sqrt();
        v = next.into_iter().map(|x| x / largest).collect();
    }
    largest / covariance.total()
}

/// A body that grows along one axis has a single mode. If each member is mapped to the sphere separately, the members
/// don't show this mode. The refinement recovers it.
#[test]
fn one_mode_is_found_again_under_maps_that_were_made_apart() {
    let sphere = Sphere::icosphere(3);
    let directions = sphere.directions.as_slice();
    let (areas, plan) = (sphere.areas(), Plan::new(directions, 8, 8).unwrap());
    let member = |i: usize| {
        let potentials =
            Array2::from_shape_fn(
                (9, 2),
                |(k, c)| {
                    if k < 4 { 0.0 } else { 0.08 * ((3 * k + 5 * c + 7 * i) as f64).sin() }
                },
            );
        let apart = Flow::from_steps(vec![potentials]).unwrap().apply(directions).unwrap();
        let axes = [3.0 + 0.2 * i as f64, 2.0, 1.5];
        let samples = Array2::from_shape_fn((directions.len(), 3), |(u, c)| areas[u] * axes[c] * apart[u][c]);
        plan.surface.adjoint_synthesis(samples.view()).unwrap()
    };
    let members: Vec<Array2<f64>> = (0..5).map(member).collect();
    let before = first_share(&members, &sphere, &vec![directions.to_vec(); 5]);
    let found = groupwise(&views(&members), &sphere, None, &stages(8, 5, 30), &Silent).unwrap();
    let at: Vec<Vec<Vec3>> = found.flows.iter().map(|flow| flow.apply(directions).unwrap()).collect();
    let after = first_share(&members, &sphere, &at);
    assert!(1.0 - after < 0.1 * (1.0 - before), "{before} {after}");
}

#[test]
fn what_cannot_be_refined_is_refused() {
    let (good, sphere) = (members(3, 3), Sphere::icosphere(1));
    let params = stages(3, 2, 1);
    let refused = |members: &[Array2<f64>], mask: Option<&[f64]>, params: &GroupwiseParams| {
        groupwise(&views(members), &sphere, mask, params, &Silent).unwrap_err()
    };
    assert!(matches!(refused(&good[..1], None, &params), ShapeError::TooFewMembers { found: 1, least: 2 }));
    let spoilt = |spoil: &dyn Fn(&mut Array2<f64>)| {
        let mut members = good.clone();
        spoil(&mut members[1]);
        match refused(&members, None, &params) {
            ShapeError::Member { index: 1, source } => *source,
            other => panic!("{other}"),
        }
    };
    assert!(matches!(spoilt(&|member| member[[2, 1]] = f64::NAN), ShapeError::NotFinite { row: 2, channel: 1, .. }));
    assert!(matches!(spoilt(&|member| *member = Array2::ones((9, 3))), ShapeError::Differ { .. }));
    assert!(matches!(spoilt(&|member| member.fill(0.0)), ShapeError::NoExtent { .. }));
    assert!(matches!(refused(&good, Some(&[1.0; 3]), &params), ShapeError::Differ { .. }));
    let n = sphere.directions.len();
    assert!(matches!(refused(&good, Some(&vec![-1.0; n]), &params), ShapeError::Setting { .. }));
    assert!(matches!(refused(&good, Some(&vec![0.0; n]), &params), ShapeError::Member { .. }));
    let none = GroupwiseParams { delta: 0.0, ..params.clone() };
    assert!(matches!(refused(&good, None, &none), ShapeError::Setting { name: "delta", .. }));
    assert!(matches!(refused(&good, None, &stages(0, 2, 1)), ShapeError::Setting { .. }));
    let bare = Sphere::from_directions(sphere.directions.clone());
    assert!(matches!(groupwise(&views(&good), &bare, None, &params, &Silent), Err(ShapeError::Setting { .. })));
    let stop = std::sync::atomic::AtomicBool::new(true);
    assert!(matches!(groupwise(&views(&good), &sphere, None, &params, &stop), Err(ShapeError::Interrupted(_))));
}
