use glam::DQuat;
use proptest::prelude::*;

use super::*;
use crate::job::run;
use crate::lod::foliage_hierarchy::naive::collapse_naive;
use crate::lod::foliage_hierarchy::quad::area_vectors;

const PARAMS: CollapseParams = CollapseParams {
    distance: Distance::Centre,
    weight: 1.0,
    d_ref: None,
    choice: Choice::Balanced,
    keep_area: true,
    target_leaf_count: 1,
    max_cost: f64::INFINITY,
};

fn areas_of(quads: &[[Vec3; 4]]) -> Vec<f64> {
    quads.iter().map(|quad| measure(&quad.map(|p| p.as_dvec3())).area).collect()
}

fn collapsed(quads: &[[Vec3; 4]], params: &CollapseParams) -> Collapsed {
    collapse(quads, &areas_of(quads), params, &Job::default()).expect("valid")
}

/// A rectangle of 2 `half.0` by 2 `half.1`, turned at random.
fn leaf(center: Vec3, half: (f32, f32), turn: DQuat) -> [Vec3; 4] {
    let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
    corners.map(|[x, y]: [f32; 2]| {
        let flat = Vec3::new(x * half.0, y * half.1, 0.0).as_dvec3();
        center + (turn * flat).as_vec3()
    })
}

/// Crowns of every kind: loose, dense, flat, and on a coarse grid where many costs are equal.
fn crown(max_count: usize) -> impl Strategy<Value = Vec<[Vec3; 4]>> {
    let turns = (-1.0..1.0_f64, -1.0..1.0_f64, -1.0..1.0_f64, 0.1..1.0_f64);
    let turns = turns.prop_map(|(x, y, z, w)| DQuat::from_xyzw(x, y, z, w).normalize());
    let loose = (prop::array::uniform3(-1.0..1.0_f32), (0.02..0.3_f32, 0.02..0.3_f32), turns)
        .prop_map(|(center, half, turn)| leaf(Vec3::from(center), half, turn));
    // whole numbers: distances and crosses are exact, so ties are real ones
    let grid = (prop::array::uniform3(0..4_i8), 0..3_usize).prop_map(|(center, axis)| {
        let center = Vec3::from(center.map(f32::from));
        let turned = |v: Vec3| match axis {
            0 => v,
            1 => Vec3::new(v.y, v.z, v.x),
            _ => Vec3::new(v.z, v.x, v.y),
        };
        let corners = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]];
        corners.map(|[x, y]: [f32; 2]| center + turned(Vec3::new(x, y, 0.0)))
    });
    let line = (0..40_u8).prop_map(|x| {
        let at = |dx: f32, dy: f32| Vec3::new(f32::from(x) + dx, dy, 0.0);
        [at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)]
    });
    prop_oneof![
        prop::collection::vec(loose, 1..max_count),
        prop::collection::vec(grid, 1..max_count),
        prop::collection::vec(line, 1..max_count),
    ]
}

fn check_same(quads: &[[Vec3; 4]], params: &CollapseParams) {
    let naive = collapse_naive(quads, &areas_of(quads), params, &Job::default());
    let naive = naive.expect("valid").forest;
    let fast = collapsed(quads, params).forest;
    let children = |forest: &Forest| -> Vec<[u32; 2]> {
        forest.nodes[quads.len()..].iter().map(|node| node.children).collect()
    };
    assert_eq!(children(&fast), children(&naive), "pairs in order");
    assert_eq!(fast, naive, "and all that follows");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    #[test]
    fn every_step_takes_the_true_minimum(
        quads in crown(200), weight in prop_oneof![Just(0.0), Just(1.0), 0.0..20.0_f64],
    ) {
        check_same(&quads, &CollapseParams { weight, ..PARAMS });
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    #[test]
    fn so_it_does_by_the_farthest_corner(quads in crown(50), weight in 0.0..2.0_f64) {
        check_same(&quads, &CollapseParams { distance: Distance::Hausdorff, weight, ..PARAMS });
    }

    #[test]
    fn and_with_every_way_to_stop(
        quads in crown(60), target in 1..70_usize, max_cost in 0.0..6.0_f64,
        d_ref in prop_oneof![Just(None), (0.01..10.0_f64).prop_map(Some)], keep_area: bool,
    ) {
        let stop = CollapseParams { target_leaf_count: target, max_cost, d_ref, keep_area, ..PARAMS };
        let choice = CollapseParams { choice: Choice::Paper, ..stop };
        check_same(&quads, &stop);
        check_same(&quads, &choice);
        let forest = collapsed(&quads, &stop).forest;
        prop_assert!(forest.root_count() >= target.min(quads.len()), "no fewer than asked for");
        prop_assert!(forest.costs.iter().all(|&cost| cost <= max_cost), "none dearer");
    }

    #[test]
    fn nodes_hold_what_they_are_made_of(quads in crown(120)) {
        check_forest(&quads, &collapsed(&quads, &PARAMS).forest);
    }
}

/// What is true of every forest.
fn check_forest(quads: &[[Vec3; 4]], forest: &Forest) {
    let areas = areas_of(quads);
    let total: f64 = areas.iter().sum();
    assert_eq!(forest.nodes.len(), 2 * quads.len() - forest.root_count(), "2 L - R");
    let roots: f64 = forest.roots().map(|root| forest.areas[root as usize]).sum();
    assert!((roots - total).abs() <= 1e-12 * total, "all area is below the roots");
    for (node, record) in (0..).zip(&forest.nodes) {
        let ball = forest.spheres[node as usize];
        let inside = |p: DVec3| p.distance(ball.center.as_dvec3()) <= f64::from(ball.radius);
        assert!(forest.drawn_quad(node).into_iter().all(inside), "{node} lies in its ball");
        if record.is_leaf() {
            continue;
        }
        for child in record.children {
            assert!(child < node, "children come first");
            assert_eq!(forest.nodes[child as usize].parent, node, "links agree");
            let vertices = forest.nodes[child as usize].vertices;
            let taken = record.vertices.iter().filter(|v| vertices.contains(v)).count();
            assert_eq!(taken, 2, "two vertices of each");
            let below = forest.spheres[child as usize];
            let reach = below.center.distance(ball.center) + below.radius;
            assert!(reach <= ball.radius * 1.000_01, "balls are nested");
        }
        let [one, other] = record.children.map(|child| forest.areas[child as usize]);
        assert_eq!(forest.areas[node as usize], one + other, "areas add up");
        let larger = record.children[usize::from(other > one)];
        let source = forest.corners[node as usize];
        assert_eq!(source.leaf, forest.corners[larger as usize].leaf, "the larger one's texture");
        if measure(&forest.quad(node)).area > 0.0 {
            let drawn = measure(&forest.drawn_quad(node)).area;
            // a scale is an f32
            let wanted = forest.areas[node as usize];
            assert!((drawn - wanted).abs() <= 1e-6 * wanted, "{drawn} of {wanted}");
        }
    }
}

#[test]
fn three_leaves_in_a_row() {
    //  3---2 7---6      11---10      leaves 0 and 1 touch, 2 stands apart
    //  |   | |   |       |    |
    //  0---1 4---5       8----9
    let at = |x: f32| {
        let corner = |dx: f32, y: f32| Vec3::new(x + dx, y, 0.0);
        [corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)]
    };
    let Collapsed { forest, rule, .. } = collapsed(&[at(0.0), at(1.0), at(4.0)], &PARAMS);
    assert_eq!(rule.d_ref, 1.0, "the side of a leaf");
    assert_eq!(forest.nodes[3].children, [0, 1], "the nearest two");
    assert_eq!(forest.nodes[3].vertices, [0, 5, 6, 3], "the rectangle around both");
    assert_eq!(forest.nodes[4].children, [2, 3], "then what is left");
    // centres at 1 and 4.5
    assert_eq!(forest.costs, [1.0, 3.5 * 3.5], "squares of distances");
    assert_eq!(forest.areas, [1.0, 1.0, 1.0, 2.0, 3.0], "added up");
    // of 2 by 1 and 1 by 1 that are 2 apart a rectangle of 3 by 1 can be made
    assert_eq!(forest.scales, [1.0; 5], "areas need no help");
    assert_eq!(measure(&forest.quad(4)).area, 3.0, "exactly");
    assert_eq!(forest.root_count(), 1, "one is left");
    assert_eq!(forest.structure_bytes(), 5 * 28 + 12 * 12, "7 words a node, 3 a vertex");
}

#[test]
fn texture_corners_stay_on_their_side() {
    // two leaves one above the other, the upper one larger: its stem is below, at corners 0 and 1
    let tall = |y: f32, h: f32| {
        [[0.0, y], [1.0, y], [1.0, y + h], [0.0, y + h]]
            .map(|[x, y]: [f32; 2]| Vec3::new(x, y, 0.0))
    };
    let forest = collapsed(&[tall(0.0, 1.0), tall(1.0, 2.0)], &PARAMS).forest;
    assert_eq!(forest.nodes[2].vertices, [0, 1, 6, 7], "around both");
    assert_eq!(forest.corners[2], TextureCorners { leaf: 1, turn: 0 }, "upright");
    // the same, with the upper leaf's corners beginning at the upper right
    let [a, b, c, d] = tall(1.0, 2.0);
    let forest = collapsed(&[tall(0.0, 1.0), [c, d, a, b]], &PARAMS).forest;
    assert_eq!(forest.nodes[2].vertices, [0, 1, 4, 5], "around both");
    assert_eq!(forest.corners[2], TextureCorners { leaf: 1, turn: 2 }, "upright again");
    assert_eq!(forest.corners[2].corner(0), 2, "corner 0 lies where the leaf's corner 2 is");
}

#[test]
fn leaves_whose_centres_lie_apart_are_found_by_their_corners() {
    // two spindles over one another, wide at opposite ends: centres are 3.3 apart, half their radius,
    // but no corner is farther than 0.5 from the other; each has a copy 0.6 above that comes first
    let spindle = |base: f32, tip: f32, z: f32| {
        [[base, 0.0], [base, 1.0], [tip, 0.5], [tip, 0.5]].map(|[x, y]| Vec3::new(x, y, z))
    };
    let (left, right) = (spindle(0.0, 10.0, 0.0), spindle(10.0, 0.0, 0.0));
    let quads = [spindle(10.0, 0.0, 0.6), spindle(0.0, 10.0, -0.6), left, right];
    let params = CollapseParams { distance: Distance::Hausdorff, weight: 0.0, ..PARAMS };
    let forest = collapsed(&quads, &params).forest;
    assert_eq!(forest.nodes[4].children, [2, 3], "the nearest by corners");
    let centres = collapsed(&quads, &CollapseParams { weight: 0.0, ..PARAMS }).forest;
    assert_ne!(centres.nodes[4].children, [2, 3], "not by centres");
    check_same(&quads, &params);
}

#[test]
fn equal_leaves_collapse_in_the_order_of_their_indices() {
    let one = leaf(Vec3::ZERO, (0.5, 0.5), DQuat::IDENTITY);
    let forest = collapsed(&[one; 5], &PARAMS).forest;
    let children: Vec<[u32; 2]> = forest.nodes[5..].iter().map(|node| node.children).collect();
    assert_eq!(children, [[0, 1], [2, 3], [4, 5], [6, 7]], "all cost 0");
    assert_eq!(forest.costs, [0.0; 4], "all alike");
}

#[test]
fn hard_cases_end() {
    let alone = leaf(Vec3::ONE, (0.5, 0.5), DQuat::IDENTITY);
    assert_eq!(collapsed(&[alone], &PARAMS).forest.nodes.len(), 1, "one leaf");
    let point = [Vec3::ONE; 4];
    let forest = collapsed(&[point; 3], &PARAMS).forest;
    assert_eq!(forest.scales, [1.0; 5], "no area to keep");
    let needle = [Vec3::ZERO, Vec3::X, Vec3::X * 2.0, Vec3::X * 3.0];
    check_forest(&[needle, point, alone], &collapsed(&[needle, point, alone], &PARAMS).forest);
    // sizes and places at the ends of what a plant may have
    for (scale, offset) in [(1e-4, 0.0), (1e4, 0.0), (1.0, 1e6)] {
        let far = Vec3::splat(offset);
        let quads: Vec<[Vec3; 4]> = (0..40_u8)
            .map(|k| {
                let center = Vec3::new(f32::from(k % 7), f32::from(k / 7), f32::from(k % 3));
                leaf(center, (0.3, 0.3), DQuat::from_rotation_x(f64::from(k)))
                    .map(|corner| corner * scale + far)
            })
            .collect();
        check_same(&quads, &PARAMS);
        check_same(&quads, &CollapseParams { distance: Distance::Hausdorff, ..PARAMS });
    }
    assert_eq!(collapsed(&[], &PARAMS).forest.nodes.len(), 0, "none at all");
}

#[test]
fn results_do_not_depend_on_threads() {
    let quads: Vec<[Vec3; 4]> = (0..5000_u16)
        .map(|k| {
            let at = |p: u16| f32::from(k.wrapping_mul(p) % 4099) / 4099.0;
            let turn = DQuat::from_rotation_x(f64::from(at(31)) * 7.0);
            leaf(Vec3::new(at(7919), at(13), at(5801)), (0.02, 0.01), turn)
        })
        .collect();
    let of = |threads| run(Some(threads), || Ok(collapsed(&quads, &PARAMS))).expect("valid");
    let (one, three) = (of(1), of(3));
    assert_eq!(one.forest, three.forest, "the same forest");
    assert_eq!(one.cost_count, three.cost_count, "by the same way");
    check_forest(&quads, &one.forest);
}

#[test]
fn bad_parameters_are_named() {
    let refused = |params: CollapseParams| {
        let quads = [[Vec3::ZERO; 4]];
        collapse(&quads, &[0.0], &params, &Job::default()).expect_err("refused").to_string()
    };
    let params = PARAMS;
    assert!(refused(CollapseParams { weight: -1.0, ..params }).starts_with("weight"), "sign");
    assert!(refused(CollapseParams { weight: f64::NAN, ..params }).starts_with("weight"), "NaN");
    for d_ref in [0.0, 1e-101, f64::INFINITY, f64::NAN] {
        let refusal = refused(CollapseParams { d_ref: Some(d_ref), ..params });
        assert!(refusal.starts_with("d_ref"), "{d_ref}");
    }
    assert!(
        refused(CollapseParams { max_cost: f64::NAN, ..params }).starts_with("max_cost"),
        "NaN"
    );
    let none = CollapseParams { target_leaf_count: 0, ..params };
    assert!(refused(none).starts_with("target_leaf_count"), "0");
    let job = Job::default();
    job.cancel();
    let stopped = collapse(&[[Vec3::ZERO; 4]; 2], &[0.0; 2], &params, &job);
    assert_eq!(stopped.expect_err("stopped"), LodError::Cancelled, "stops");
}

#[test]
fn folded_quads_are_what_balance_avoids() {
    // of a dense crown at a tenth of its leaves: how flat what is left is
    let quads: Vec<[Vec3; 4]> = (0..600_u16)
        .map(|k| {
            let at = |p: u16| f32::from(k.wrapping_mul(p) % 601) / 601.0;
            let turn = DQuat::from_rotation_x(f64::from(at(31)) * 7.0);
            leaf(Vec3::new(at(79), at(13), at(58)), (0.05, 0.05), turn)
        })
        .collect();
    let flatness = |choice: Choice| {
        let stop = CollapseParams { choice, target_leaf_count: 60, ..PARAMS };
        let forest = collapsed(&quads, &stop).forest;
        let shares = forest.roots().map(|root| {
            let [one, other] = area_vectors(&forest.quad(root));
            (one + other).length() / (one.length() + other.length())
        });
        shares.sum::<f64>() / 60.0
    };
    let (balanced, paper) = (flatness(Choice::Balanced), flatness(Choice::Paper));
    assert!(balanced > paper + 0.1, "{balanced} {paper}");
}
