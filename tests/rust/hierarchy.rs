//! Links: what push and pull keep, agreement with all pairs, the errors that they tell, and where refinement ends.

use radiosity::assembly::{Blockers, FormFactors, Order};
use radiosity::geometry::Vec3;
use radiosity::hierarchy::functions::place;
use radiosity::hierarchy::push_pull::Layout;
use radiosity::hierarchy::tree::Tree;
use radiosity::hierarchy::{HierarchicalOptions, Links, Reached, Solver, form_factors};
use radiosity::scene::{Scene, Sides};
use radiosity::{Error, Progress, Result};

use crate::common::{
    Mesh, PLENTY, Random, assert_close, box_from, box_in_box, cube, dense, icosphere, invalid, on_threads, plate,
    stack_in_box, table, vec3,
};

fn links(scene: &Scene, tolerance: f64) -> (Links, Reached) {
    let options = HierarchicalOptions { tolerance, seed: 0, memory: PLENTY };
    form_factors(scene, &options, &Progress::default()).unwrap()
}

fn scenes() -> Vec<(&'static str, Scene)> {
    vec![
        ("cube", cube(4).scene()),
        ("sphere", icosphere(2).reversed().scene()),
        ("box in a box", box_in_box(4).scene()),
        ("stack", stack_in_box(1).scene()),
        ("next to walls", next_to_walls().scene()),
    ]
}

/// A room of large patches with boxes of small ones, almost at its ceiling and at a wall.
fn next_to_walls() -> Mesh {
    let boxes = [[vec3(0.3, 0.35, 0.9), vec3(0.55, 0.6, 0.996)], [vec3(0.6, 0.1, 0.3), vec3(0.99, 0.4, 0.5)]];
    boxes.into_iter().fold(cube(2), |mesh, [low, high]| mesh.and(&box_from(low, high, 4).reversed()))
}

/// A scene of one band with this reflectance everywhere.
fn lit(mesh: &Mesh, rho: f64, emission: impl Fn(usize) -> f64) -> Scene {
    mesh.scene_with(1, Sides::Front, |_, _| rho, |i, _| emission(i))
}

/// One square of a wall glows.
fn lamp(i: usize) -> f64 {
    if i < 2 { 5.0 } else { 0.0 }
}

/// A tree with some leaves cut, twice.
fn cut_tree(scene: &Scene) -> Tree {
    let mut tree = Tree::new(scene, &Blockers::of_scene(scene).bodies, Order::Linear);
    for patch in [0, scene.len() / 2] {
        let node = tree.node_of[patch] as usize;
        tree.divide(node);
        let child = tree.nodes[node].children.start as usize + 1;
        tree.divide(child);
    }
    tree
}

#[test]
fn power_and_linear_functions_are_the_same_on_every_level() {
    for (_, scene) in scenes() {
        let tree = cut_tree(&scene);
        let layout = Layout::new(&tree);
        let random = Random::new(7);
        let mut moments = vec![0.0; layout.len()];
        let mut power = 0.0;
        for (k, node) in tree.nodes.iter().enumerate().filter(|(_, node)| node.is_leaf()) {
            for (function, m) in moments[layout.of(k, 1)].iter_mut().enumerate() {
                *m = node.area * random.uniform();
                power += if function == 0 { *m } else { 0.0 };
            }
        }
        layout.pull(1, &mut moments);
        // A sum of a thousand terms, in another order.
        assert_close(moments[0], power, 1e-12 * power);

        // What is linear on a flat cluster arrives at its leaves as the same function.
        let Some(top) = tree.nodes.iter().position(|node| node.plane.is_some() && !node.is_element()) else { continue };
        let mut arriving = vec![0.0; layout.len()];
        let own = layout.of(top, 1);
        arriving[own.clone()].iter_mut().for_each(|x| *x = random.between(-1.0, 1.0));
        let coefficients = arriving[own].to_vec();
        layout.push(1, &mut arriving);
        for (k, node) in tree.nodes.iter().enumerate().filter(|(_, node)| node.is_leaf()) {
            let is_below = layout.up(k).any(|above| above == top);
            let values = tree.nodes[top].functions.at(&place(node.centre, node.normal()));
            let sum: f64 = coefficients.iter().zip(values).map(|(a, value)| a * value).sum();
            let expected = if is_below { sum } else { 0.0 };
            // Of numbers up to about 2, a few levels down.
            assert_close(arriving[layout.of(k, 1).start], expected, 1e-12);
        }
    }
}

#[test]
fn links_between_single_patches_are_the_dense_operator() {
    // So tight that no cluster is good enough; without blockers, whose shadows would take minutes.
    let tolerance = 1e-6;
    for (name, scene) in scenes().into_iter().take(2) {
        let (exact, (links, _)) = (dense(&scene, tolerance, 0), links(&scene, tolerance));
        let (mut a, mut b) = (vec![0.0; scene.len()], vec![0.0; scene.len()]);
        for i in 0..scene.len() {
            exact.row(i, &mut a);
            links.row(i, &mut b);
            let error: f64 = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).sum();
            // Each is within the tolerance of the truth.
            assert!(error <= 2.0 * tolerance, "{name}: row {i} differs by {error}");
        }
    }
}

#[test]
fn rows_are_within_the_tolerance_and_symmetric() {
    for (name, scene) in scenes() {
        // Between the plates of the stack only segments tell: slowly, and with a standard error, of which a row may have two.
        let (own, errors) = if name == "stack" { (1e-2, 2.0) } else { (1e-3, 1.0) };
        let exact = dense(&scene, own, 0);
        for tolerance in [0.3, 0.1, 0.03] {
            let (links, reached) = links(&scene, tolerance);
            assert!(reached.error_estimate <= tolerance, "{name}: {} at {tolerance}", reached.error_estimate);
            let n = scene.len();
            let rows = table(&links);
            let mut row = vec![0.0; n];
            for i in 0..n {
                exact.row(i, &mut row);
                let error: f64 = row.iter().zip(&rows[i * n..]).map(|(a, b)| (a - b).abs()).sum();
                // The reference has an error of its own.
                assert!(error <= errors * tolerance + own, "{name}: row {i} is off by {error} at {tolerance}");
                for j in 0..n {
                    let [there, back] = [scene.areas()[i] * rows[i * n + j], scene.areas()[j] * rows[j * n + i]];
                    // One number read from two sides, with roundings of the tree on the way.
                    assert_close(there, back, 1e-13 * scene.areas()[i]);
                }
            }
        }
    }
}

#[test]
fn a_row_is_right_that_sees_what_no_other_of_its_cluster_sees() {
    // Two slabs hide the floor of a room but for one square in a corner, from where a shaft leads up. All around is closed.
    let k = 24;
    let square = 1.0 / k as f64;
    let (low, high) = (vec3(-0.1, -0.1, -0.1), vec3(1.1, 1.1, 0.1));
    let slabs = box_from(vec3(low.x, square, low.z), high, 1);
    let slabs = slabs.and(&box_from(vec3(square, low.y, low.z), vec3(high.x, square, high.z), 1));
    let scene = cube(k).and(&slabs.reversed()).scene();
    let is_corner = |i: &usize| scene.triangle(*i).iter().all(|x| x.z == 0.0 && x.x.max(x.y) < 1.5 * square);
    let corner: Vec<usize> = (0..scene.len()).filter(is_corner).collect();
    assert_eq!(corner.len(), 2);
    let mut row = vec![0.0; scene.len()];
    for tolerance in [0.3, 0.1] {
        let (links, _) = links(&scene, tolerance);
        for &i in &corner {
            links.row(i, &mut row);
            let sum: f64 = row.iter().sum();
            // 1 in a closed scene: what is missed is missing from it.
            assert!((sum - 1.0).abs() <= tolerance, "row {i} sums to {sum} at {tolerance}");
        }
    }
}

#[test]
fn gather_shoot_and_rows_are_the_product() {
    let scene = box_in_box(3).scene();
    let (links, _) = links(&scene, 0.1);
    let (n, bands) = (scene.len(), 2);
    let random = Random::new(3);
    let x: Vec<f64> = (0..n * bands).map(|_| random.uniform()).collect();
    let mut product = vec![0.0; n * bands];
    links.apply(&x, bands, &mut product);
    let (mut shot, mut one, mut row) = (vec![0.0; n * bands], vec![0.0; bands], vec![0.0; n]);
    for i in 0..n {
        links.gather(i, &x, &mut one);
        links.row(i, &mut row);
        for b in 0..bands {
            let by_row: f64 = row.iter().enumerate().map(|(j, f)| f * x[j * bands + b]).sum();
            // Irradiances are about 1/2; sums of a few hundred terms in other orders.
            assert_close(one[b], product[i * bands + b], 1e-13);
            assert_close(by_row, product[i * bands + b], 1e-13);
        }
        links.shoot(i, &x[i * bands..][..bands], &mut shot);
    }
    for (shot, product) in shot.iter().zip(&product) {
        assert_close(*shot, *product, 1e-13);
    }
}

#[test]
fn links_are_the_same_bits_for_any_number_of_threads() {
    let scene = box_in_box(3).scene();
    let bits = || {
        let (links, _) = links(&scene, 0.1);
        let mut out = vec![0.0; scene.len()];
        links.apply(scene.areas(), 1, &mut out);
        out.iter().map(|x| x.to_bits()).collect::<Vec<u64>>()
    };
    let one = on_threads(1, bits);
    assert_eq!(one, on_threads(2, bits));
    assert_eq!(one, on_threads(5, bits));
}

/// Links a patch.
fn density(mesh: &Mesh, tolerance: f64) -> f64 {
    let scene = mesh.scene();
    links(&scene, tolerance).0.found.links.len() as f64 / scene.len() as f64
}

#[test]
fn links_a_patch_become_fewer_in_a_bowl_of_more_facets() {
    // Half of a sphere over a plate that lies behind it: every facet has something on either side, and none is in the way.
    let bowl = |level: usize| {
        let mut bowl = icosphere(level).reversed();
        let vertices = bowl.vertices.clone();
        bowl.faces.retain(|face| face.iter().map(|&v| vertices[v as usize].z).sum::<f64>() < 0.0);
        bowl.and(&plate(vec3(-10.0, -10.0, -2.0), 20.0 * Vec3::Y, 20.0 * Vec3::X, 1))
    };
    let [few, many] = [3, 5].map(|level| density(&bowl(level), 0.1));
    assert!(many < 0.5 * few, "{few} links a patch, {many} of sixteen times as many");
}

#[test]
fn links_a_patch_stay_few_where_patches_lie_partly_beneath_a_block() {
    // Its foot runs through patches, of which a part sees nothing.
    let room = |k: usize| cube(k).and(&box_from(vec3(0.31, 0.27, 0.0), vec3(0.71, 0.63, 0.4), k));
    let [few, many] = [8, 24].map(|k| density(&room(k), 0.3));
    assert!(many < few, "{few} links a patch, {many} of nine times as many");
}

#[test]
fn tolerances_out_of_range_are_refused() {
    for tolerance in [0.0, -1.0, 1.0, f64::NAN] {
        let options = HierarchicalOptions { tolerance, seed: 0, memory: PLENTY };
        let refused = form_factors(&cube(1).scene(), &options, &Progress::default());
        assert!(invalid(refused.map(|_| ())).contains("tolerance"), "{tolerance}");
    }
}

fn solved(scene: &Scene, tolerance: f64, memory: u64, check: impl FnOnce(&Solver)) -> Result<()> {
    let blockers = Blockers::of_scene(scene);
    let mut solver = Solver::new(scene, &blockers, 0, memory)?;
    solver.refine_to(tolerance, &Progress::default())?;
    check(&solver);
    Ok(())
}

#[test]
fn a_furnace_is_exact_and_not_refined() {
    for rho in [0.0, 0.5, 0.99, 0.999_999] {
        let scene = lit(&cube(4), rho, |_| 2.0);
        solved(&scene, 0.5, PLENTY, |solver| {
            for h in solver.patch_irradiance() {
                // B = E / (1 - rho) = H everywhere; the solver's residual of 1e-4 of the first bounce vanishes with it.
                let exact = 2.0 / (1.0 - rho);
                assert_close(h, exact, 1e-9 * exact);
            }
            assert_eq!(solver.leaves(), scene.len(), "nothing changes from place to place");
            assert!(solver.links().found.links.len() < 20, "six walls that each see five");
        })
        .unwrap();
    }
}

#[test]
fn a_white_room_that_only_rays_know_to_be_closed_is_refused() {
    // The floor is cut finer than the walls: by its edges the room has gaps.
    let floor = plate(Vec3::ZERO, Vec3::X, Vec3::Y, 2);
    let others = [
        plate(Vec3::Z, Vec3::Y, Vec3::X, 1),
        plate(Vec3::ZERO, Vec3::Y, Vec3::Z, 1),
        plate(Vec3::X, Vec3::Z, Vec3::Y, 1),
        plate(Vec3::ZERO, Vec3::Z, Vec3::X, 1),
        plate(Vec3::Y, Vec3::X, Vec3::Z, 1),
    ];
    let room = others.iter().fold(floor, Mesh::and);
    let scene = lit(&room, 1.0, |_| 1.0);
    assert!(invalid(solved(&scene, 0.1, PLENTY, |_| ())).contains("reflectance 1"));
}

#[test]
fn power_is_accounted_for() {
    let scene = lit(&box_in_box(2), 0.7, lamp);
    solved(&scene, 0.05, PLENTY, |solver| {
        let audit = solver.audit();
        let gap = audit.emitted[0] - audit.absorbed[0] - audit.left[0];
        // What is left is the residual of the iteration.
        assert!(gap.abs() <= 1e-3 * audit.emitted[0], "{gap}");
        // A closed scene loses nothing.
        assert_close(audit.left[0], 0.0, 0.0);
    })
    .unwrap();
}

#[test]
fn refinement_ends_where_memory_does() {
    let scene = lit(&box_in_box(2), 0.5, lamp);
    let small = 20_000_000;
    solved(&scene, 1e-4, small, |solver| {
        assert!(solver.done.out_of_memory);
        assert!(solver.link_error > 1e-4 && solver.link_error.is_finite());
        assert!((solver.links().nbytes() as u64) < small, "{}", solver.links().nbytes());
    })
    .unwrap();
    let refused = solved(&scene, 0.1, 1000, |_| ());
    assert!(matches!(refused, Err(Error::Memory { .. })));
}

#[test]
fn form_factors_without_memory_know_how_wrong_they_are() {
    let scene = box_in_box(4).scene();
    let exact = table(&dense(&scene, 1e-3, 0));
    for memory in [3_000_000, 6_000_000] {
        let options = HierarchicalOptions { tolerance: 0.01, seed: 0, memory };
        let (links, reached) = form_factors(&scene, &options, &Progress::default()).unwrap();
        let rows = table(&links);
        let n = scene.len();
        let error = |i: usize| (i * n..(i + 1) * n).map(|k| (rows[k] - exact[k]).abs()).sum::<f64>();
        let worst = (0..n).map(error).fold(0.0, f64::max);
        // The reference has an error of its own.
        assert!(worst <= reached.error_estimate + 1e-3, "{worst} for {} with {memory}", reached.error_estimate);
        assert!(reached.error_estimate > 0.01);
    }
}

/// A cube of white walls without one of its triangles; two others glow.
fn white_box_with_a_hole(rho: f64) -> Scene {
    let mut room = cube(6);
    room.faces.pop();
    lit(&room, rho, lamp)
}

#[test]
fn light_in_a_white_room_with_a_hole_is_never_negative() {
    for rho in [0.97, 0.999, 0.9999] {
        let scene = white_box_with_a_hole(rho);
        solved(&scene, 0.3, 100_000_000, |solver| {
            let mean = |values: &[f64]| {
                let power: f64 = scene.areas().iter().zip(values).map(|(area, x)| area * x).sum();
                power / scene.areas().iter().sum::<f64>()
            };
            // All walls have about the same: what is emitted is absorbed, or leaves by the hole, 1 / 432 of the walls.
            let (absorbed, leaves) = (1.0 - rho, 1.0 / 432.0);
            let expected = mean(scene.emission()) / (absorbed + leaves);
            let h = mean(&solver.patch_irradiance());
            assert!(h > 0.0, "{h} at {rho}");
            // The hole sees a little more or less than the mean: 10 % of what leaves.
            let error = (h / expected - 1.0).abs();
            assert!(error <= solver.link_error + 0.1, "{h} for {expected} at {rho}, {} told", solver.link_error);
        })
        .unwrap();
    }
}

#[test]
fn units_of_power_change_nothing() {
    let errors: Vec<f64> = [1e-200, 1.0, 1e160, 1e300]
        .into_iter()
        .map(|unit| {
            let scene = lit(&box_in_box(2), 0.5, |i| unit * lamp(i));
            let mut told = 0.0;
            solved(&scene, 0.1, PLENTY, |solver| told = solver.link_error).unwrap();
            told
        })
        .collect();
    for error in &errors {
        // Roundings differ by unit.
        assert_close(*error, errors[1], 1e-6 * errors[1]);
    }
}

#[test]
fn what_stops_refinement_is_counted() {
    // A lamp of a hundredth of the smallest element just above the floor: no link to it is good enough.
    let [floor, small] = [1.0, 1e-5];
    let corner = Vec3::new(0.3, 0.3, small);
    let mesh =
        plate(Vec3::ZERO, floor * Vec3::X, floor * Vec3::Y, 1).and(&plate(corner, small * Vec3::Y, small * Vec3::X, 1));
    let scene = lit(&mesh, 0.5, |i| if i >= 2 { 1.0 } else { 0.0 });
    solved(&scene, 1e-3, PLENTY, |solver| {
        assert!(solver.link_error > 1e-3, "{}", solver.link_error);
        assert!(solver.done.stopped > 0 && !solver.done.out_of_memory);
    })
    .unwrap();
}

#[test]
fn a_part_that_loses_nothing_is_refused() {
    let mut far = cube(1);
    far.vertices.iter_mut().for_each(|v| v.x += 10.0);
    let n = far.faces.len();
    let scene = cube(1).and(&far).scene_with(
        1,
        Sides::Front,
        |i, _| if i < n { 0.5 } else { 1.0 },
        |i, _| f64::from(i % n == 0),
    );
    assert!(invalid(solved(&scene, 0.1, PLENTY, |_| ())).contains("light grows"));
}

#[test]
fn the_mesh_of_leaves_has_no_gaps() {
    let scene = lit(&box_in_box(2), 0.5, lamp);
    solved(&scene, 0.03, PLENTY, |solver| {
        let (mesh, irradiance) = solver.mesh();
        assert!(mesh.faces.len() > scene.len(), "shadows ask for more");
        // Every edge of a closed surface is run through both ways as often.
        let mut edges = std::collections::HashMap::new();
        for &[a, b, c] in &mesh.faces {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                *edges.entry((from.min(to), from.max(to))).or_insert(0i32) += if from < to { 1 } else { -1 };
            }
        }
        assert!(edges.values().all(|balance| *balance == 0));
        let area = |face: &[u32; 3]| {
            let [a, b, c]: [Vec3; 3] = face.map(|v| mesh.vertices[v as usize]);
            0.5 * (b - a).cross(c - a).length()
        };
        let total: f64 = mesh.faces.iter().map(area).sum();
        let expected: f64 = scene.areas().iter().sum();
        assert_close(total, expected, 1e-12 * expected);
        // Faces hold the power of their patches.
        let on_faces: f64 = mesh.faces.iter().zip(&irradiance).map(|(face, h)| area(face) * h).sum();
        let on_patches: f64 = scene.areas().iter().zip(solver.patch_irradiance()).map(|(area, h)| area * h).sum();
        assert_close(on_faces, on_patches, 1e-11 * on_patches);
    })
    .unwrap();
}
