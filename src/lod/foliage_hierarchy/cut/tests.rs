//! Is the cut the one that the definition gives, however it is reached?

use glam::{DAffine3, DMat3, DVec3};
use proptest::prelude::*;

use super::*;
use crate::lod::foliage_hierarchy::criteria::{Criterion, Mask, Placed};
use crate::lod::foliage_hierarchy::made::{chain, forest, random_forest};
use crate::lod::foliage_hierarchy::uniform::uniform;
use crate::view::{Projection, View};

fn view_from(eye: DVec3, target: DVec3, projection: Projection) -> View {
    View::new(eye, target, DVec3::new(0.1, 1.0, 0.2), projection, (640, 480), 0.01).expect("valid")
}

fn far_view() -> View {
    let projection = Projection::Perspective { fov_y: 0.8 };
    view_from(DVec3::new(0.0, 5.0, 60.0), DVec3::ZERO, projection)
}

const fn here(view: &View) -> Placed<'_> {
    Placed { view, world_from_local: DAffine3::IDENTITY }
}

fn all() -> Criterion {
    Criterion::And(vec![])
}

fn none() -> Criterion {
    Criterion::Or(vec![])
}

/// The definition, node by node and place by place, with no ball and no memory.
fn naive(forest: &Forest, order: &DepthFirst, zone: &Zone, rule: Rule) -> Vec<u32> {
    let own: Vec<bool> = (0..forest.nodes.len())
        .map(|node| {
            let at = order.place_of[node] as usize;
            zone.holds(at, &order.places[at]).0
        })
        .collect();
    let mut below = vec![false; own.len()];
    for (node, facts) in forest.nodes.iter().enumerate() {
        if facts.parent != NONE {
            below[facts.parent as usize] |= below[node] | own[node];
        }
    }
    let needs = |node: usize| {
        !forest.nodes[node].is_leaf() && (below[node] || (rule == Rule::Inclusive && own[node]))
    };
    let mut active: Vec<u32> = (0..)
        .zip(&forest.nodes)
        .filter(|&(node, facts)| {
            let under = facts.parent == NONE || needs(facts.parent as usize);
            under && !needs(node as usize)
        })
        .map(|(node, _)| node)
        .collect();
    active.sort_by_key(|&node| order.place_of[node as usize]);
    active
}

/// Whether every leaf has exactly one active node at or above it.
fn covers(forest: &Forest, active: &[u32]) -> bool {
    let mut is_active = vec![false; forest.nodes.len()];
    for &node in active {
        is_active[node as usize] = true;
    }
    (0..forest.leaf_count).all(|leaf| {
        let path = std::iter::successors(Some(leaf), |&node| {
            Some(forest.nodes[node as usize].parent).filter(|&parent| parent != NONE)
        });
        path.filter(|&node| is_active[node as usize]).count() == 1
    })
}

fn zone(criterion: &Criterion, forest: &Forest, order: &DepthFirst, placed: &Placed<'_>) -> Zone {
    Zone::new(criterion, forest, order, placed).expect("valid")
}

/// Four leaves at x = 0, 2, 4, 6; their pairs; all of them. Plus a leaf of its own at 8.
///
/// ```text
///        7
///      5   6
///     0 1 2 3   4
/// ```
fn five() -> Forest {
    forest(5, &[[0, 1], [2, 3], [5, 6]])
}

fn ball(x: f64, radius: f64) -> Criterion {
    let center = DVec3::X * x;
    Criterion::Sphere { center, radius, is_fine_inside: true, growth: 0.0 }
}

#[test]
fn what_a_ball_marks_is_drawn_by_its_leaves() {
    let forest = five();
    let order = DepthFirst::new(&forest);
    let view = far_view();
    let cases: [(Criterion, &[u32], &str); 6] = [
        (none(), &[4, 7], "roots"),
        (all(), &[4, 0, 1, 2, 3], "leaves"),
        (ball(0.0, 0.5), &[4, 0, 1, 6], "the pair with leaf 0, and its sister"),
        (ball(6.0, 0.5), &[4, 5, 2, 3], "the pair with leaf 3, and its sister"),
        (ball(8.0, 0.5), &[4, 7], "a leaf that nothing lies below"),
        (ball(0.0, 20.0), &[4, 0, 1, 2, 3], "everything"),
    ];
    for (criterion, expected, what) in cases {
        let zone = zone(&criterion, &forest, &order, &here(&view));
        assert_eq!(scratch(&order, &zone, Rule::Inclusive).0, expected, "{what}");
        assert_eq!(naive(&forest, &order, &zone, Rule::Inclusive), expected, "{what}, naive");
    }
}

#[test]
fn by_the_papers_rule_a_node_does_not_count_for_itself() {
    let forest = five();
    let order = DepthFirst::new(&forest);
    let view = far_view();
    // node 5 stands on corners of leaves 0 and 1, and no leaf has its centre there
    let center = order.places[order.place_of[5] as usize].center.as_dvec3();
    let criterion = Criterion::Sphere { center, radius: 0.01, is_fine_inside: true, growth: 0.0 };
    let zone = zone(&criterion, &forest, &order, &here(&view));
    assert_eq!(scratch(&order, &zone, Rule::Inclusive).0, [4, 0, 1, 6], "5 is needed finer");
    assert_eq!(scratch(&order, &zone, Rule::Paper).0, [4, 5, 6], "5 is what is wanted");
    let mut cut = Cut::new(&forest, &order);
    for (rule, expected) in [
        (Rule::Inclusive, &[4, 0, 1, 6][..]),
        (Rule::Paper, &[4, 5, 6]),
        (Rule::Inclusive, &[4, 0, 1, 6]),
    ] {
        cut.update(&forest, &order, zone.clone(), rule);
        assert_eq!(cut.active(), expected, "another rule for the same view: {rule:?}");
    }
}

#[test]
fn steps_are_counted_as_the_paper_names_them() {
    let forest = five();
    let order = DepthFirst::new(&forest);
    let view = far_view();
    let mut cut = Cut::new(&forest, &order);
    let counts = |steps: Steps| {
        [
            steps.collapse_count,
            steps.forced_collapse_count,
            steps.split_count,
            steps.forced_split_count,
        ]
    };
    let mut update = |criterion: &Criterion| {
        let zone = zone(criterion, &forest, &order, &here(&view));
        let steps = cut.update(&forest, &order, zone, Rule::Inclusive);
        (cut.active().to_vec(), counts(steps))
    };
    assert_eq!(update(&none()), (vec![4, 7], [0, 0, 0, 0]), "begins with the roots");
    let split = (vec![4, 0, 1, 6], [0, 0, 1, 1]);
    assert_eq!(update(&ball(0.0, 0.5)), split, "7 is split, which forces 5");
    assert_eq!(update(&all()), (vec![4, 0, 1, 2, 3], [0, 0, 1, 0]), "6 is split");
    let moved = (vec![4, 5, 2, 3], [1, 0, 0, 0]);
    assert_eq!(update(&ball(6.0, 0.5)), moved, "0 and 1 collapse");
    assert_eq!(update(&none()), (vec![4, 7], [1, 1, 0, 0]), "2 and 3, which forces 7");
}

#[test]
fn each_node_is_asked_at_most_once_and_blocks_are_passed() {
    let forest = chain(1000);
    let order = DepthFirst::new(&forest);
    let view = far_view();
    let criterion = ball(1000.0, 300.5);
    let placed = here(&view);
    let (active, steps) = scratch(&order, &zone(&criterion, &forest, &order, &placed), Rule::Paper);
    assert!(steps.asked_ball_count <= 999, "one a ball: {steps:?}");
    assert!(steps.asked_node_count <= 1999, "one a node: {steps:?}");
    let mut cut = Cut::new(&forest, &order);
    cut.update(&forest, &order, zone(&criterion, &forest, &order, &placed), Rule::Paper);
    assert_eq!(cut.active(), active, "as from scratch");
    let again =
        cut.update(&forest, &order, zone(&criterion, &forest, &order, &placed), Rule::Paper);
    assert_eq!(again, Steps::default(), "nothing has changed, so nothing is asked");
    let nudged = ball(1000.001, 300.5);
    let again = cut.update(&forest, &order, zone(&nudged, &forest, &order, &placed), Rule::Paper);
    assert_eq!(again.asked_ball_count + again.asked_node_count, 0, "far from any edge: {again:?}");
    assert_eq!(again.passed_count, 1, "one tree, one block");
}

#[test]
fn deep_forests_need_no_recursion() {
    let forest = chain(100_000);
    let order = DepthFirst::new(&forest);
    let view = far_view();
    let placed = here(&view);
    let mut cut = Cut::new(&forest, &order);
    for (criterion, expected) in [(all(), 100_000), (none(), 1), (ball(0.0, 0.5), 100_000)] {
        let zone = zone(&criterion, &forest, &order, &placed);
        assert_eq!(scratch(&order, &zone, Rule::Inclusive).0.len(), expected, "{criterion:?}");
        cut.update(&forest, &order, zone, Rule::Inclusive);
        assert_eq!(cut.active().len(), expected, "{criterion:?}");
    }
}

#[test]
fn one_leaf_and_roots_alone_are_drawn_whatever_is_asked() {
    let view = far_view();
    for forest in [forest(1, &[]), forest(4, &[])] {
        let order = DepthFirst::new(&forest);
        let roots: Vec<u32> = forest.roots().collect();
        let mut cut = Cut::new(&forest, &order);
        for criterion in [all(), none(), Criterion::Frustum, ball(0.0, 1.0)] {
            for rule in [Rule::Inclusive, Rule::Paper] {
                let zone = zone(&criterion, &forest, &order, &here(&view));
                assert_eq!(scratch(&order, &zone, rule).0, roots, "{criterion:?}");
                cut.update(&forest, &order, zone, rule);
                assert_eq!(cut.active(), roots, "{criterion:?}");
            }
        }
    }
}

#[test]
fn all_that_a_view_shows_is_fine_with_the_frustum() {
    let forest = chain(50);
    let order = DepthFirst::new(&forest);
    let projection = Projection::Perspective { fov_y: 0.5 };
    let view = view_from(DVec3::new(40.0, 0.0, 10.0), DVec3::X * 40.0, projection);
    let zone = zone(&Criterion::Frustum, &forest, &order, &here(&view));
    let (active, _) = scratch(&order, &zone, Rule::Inclusive);
    let seen: Vec<u32> = (0..50)
        .filter(|&leaf| {
            let ball = forest.spheres[leaf as usize];
            view.sees_ball(ball.center.as_dvec3(), f64::from(ball.radius))
        })
        .collect();
    assert!((3..40).contains(&seen.len()), "a part of it: {seen:?}");
    assert!(seen.iter().all(|leaf| active.contains(leaf)), "{seen:?} of {active:?}");
    assert!(active.len() < 50, "but not what is off the picture: {active:?}");
}

#[test]
fn the_eye_inside_a_ball_sees_it_without_limit() {
    let forest = five();
    let order = DepthFirst::new(&forest);
    let view = view_from(DVec3::ZERO, DVec3::Z, Projection::Perspective { fov_y: 1.0 });
    let size = Criterion::ScreenSize { pixels: 1e15 };
    let zone_here = zone(&size, &forest, &order, &here(&view));
    // 7, 5 and 0 hold the eye; 1 and 6 do not
    assert_eq!(scratch(&order, &zone_here, Rule::Inclusive).0, [4, 0, 1, 6], "around the eye");
}

#[test]
fn sizes_on_the_screen_are_those_of_outlines() {
    let forest = forest(2, &[[0, 1]]);
    let order = DepthFirst::new(&forest);
    let ball = forest.spheres[2];
    let (center, radius) = (ball.center.as_dvec3(), f64::from(ball.radius));
    let eye = center + DVec3::new(3.0, 4.0, 12.0);
    for (projection, scale) in [
        (Projection::Perspective { fov_y: 0.7 }, 1.0),
        (Projection::Perspective { fov_y: 0.7 }, 0.25),
        (Projection::Orthographic { height: 30.0 }, 1.0),
        (Projection::Orthographic { height: 30.0 }, 3.0),
    ] {
        // the copy is turned, mirrored and scaled about the ball's centre
        let turn = DMat3::from_rotation_y(1.0) * DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0));
        let linear = turn * scale;
        let world_from_local = DAffine3::from_mat3_translation(linear, center - linear * center);
        let view = view_from(eye, center, projection);
        let radius = radius * scale;
        let size_px = match projection {
            Projection::Perspective { .. } => {
                2.0 * radius / (169.0 - radius * radius).sqrt() * view.pixels_per_metre_at_one()
            }
            Projection::Orthographic { .. } => 2.0 * radius * view.pixels_per_metre_at_one(),
        };
        let placed = Placed { view: &view, world_from_local };
        for (factor, expected) in [(0.999_999, &[0, 1][..]), (1.000_001, &[2])] {
            let size = Criterion::ScreenSize { pixels: size_px * factor };
            let zone = zone(&size, &forest, &order, &placed);
            let got = scratch(&order, &zone, Rule::Inclusive).0;
            assert_eq!(got, expected, "{projection:?} at {scale}, {factor} of its size");
        }
    }
}

#[test]
fn lists_that_do_not_cover_are_refused() {
    let forest = five();
    let order = DepthFirst::new(&forest);
    let mut cut = Cut::new(&forest, &order);
    let cases: [(&[u32], &str); 5] = [
        (&[4], "active: 4 leaves at the end are not drawn"),
        (&[4, 5, 2], "active: 1 leaves at the end are not drawn"),
        (&[7, 4], "active: leaves before node 7 are not drawn exactly once"),
        (&[4, 7, 2], "active: leaves before node 2 are not drawn exactly once"),
        (&[8], "active: node 8 is none of the forest's 8"),
    ];
    for (active, expected) in cases {
        let error = cut.set_active(&order, active.to_vec()).expect_err(expected);
        assert_eq!(error.to_string(), expected, "named");
        assert_eq!(cut.active(), [4, 7], "left as it was");
    }
    cut.set_active(&order, vec![4, 5, 2, 3]).expect("covers");
    let view = far_view();
    let zone = zone(&none(), &forest, &order, &here(&view));
    let steps = cut.update(&forest, &order, zone, Rule::Inclusive);
    assert_eq!((cut.active(), steps.collapse_count), (&[4, 7][..], 1), "goes on from there");
}

#[test]
fn masks_answer_once_for_all_nodes_or_fail_as_they_do() {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};
    let forest = five();
    let order = DepthFirst::new(&forest);
    let view = far_view();
    let calls = Arc::new(AtomicUsize::new(0));
    let counted = Arc::clone(&calls);
    let mask = Criterion::Mask(Mask::new(move |forest, placed| {
        counted.fetch_add(1, Ordering::Relaxed);
        assert_eq!(placed.view.eye, DVec3::new(0.0, 5.0, 60.0), "the view is handed on");
        Ok((0..forest.nodes.len()).map(|node| node == 2).collect())
    }));
    let zone = zone(&mask, &forest, &order, &here(&view));
    let mut cut = Cut::new(&forest, &order);
    cut.update(&forest, &order, zone, Rule::Inclusive);
    assert_eq!(cut.active(), [4, 5, 2, 3], "what node 2 asks for");
    assert_eq!(calls.load(Ordering::Relaxed), 1, "one call");
    let short = Criterion::Mask(Mask::new(|_, _| Ok(vec![true; 3])));
    let error = Zone::new(&short, &forest, &order, &here(&view)).expect_err("too few answers");
    let expected = "criterion: must answer for each of 8 nodes, got 3 answers";
    assert_eq!(error.to_string(), expected, "counted");
    let failing = Criterion::Mask(Mask::new(|_, _| Err(LodError::Cancelled)));
    let error = Zone::new(&failing, &forest, &order, &here(&view)).expect_err("fails");
    assert_eq!(error, LodError::Cancelled, "as it came");
}

fn criterion() -> impl Strategy<Value = Criterion> {
    let vector = || prop::array::uniform3(-12.0_f64..12.0).prop_map(DVec3::from);
    let leaf = prop_oneof![
        (vector(), 0.0..15.0_f64, any::<bool>(), 0.0..0.5_f64).prop_map(
            |(center, radius, is_fine_inside, growth)| Criterion::Sphere {
                center,
                radius,
                is_fine_inside,
                growth
            }
        ),
        (vector(), vector()).prop_map(|(point, normal)| Criterion::Plane {
            point,
            normal: normal + DVec3::splat(0.01)
        }),
        Just(Criterion::Frustum),
        (0.0..200.0_f64).prop_map(|pixels| Criterion::ScreenSize { pixels }),
        (0.0..40.0_f64).prop_map(|max_distance| Criterion::Distance { max_distance }),
        Just(Criterion::And(vec![])),
        Just(Criterion::Or(vec![])),
        any::<u64>().prop_map(|seed| {
            Criterion::Mask(Mask::new(move |forest, _| {
                let answer =
                    |node: u32| (seed.rotate_left(node % 64) >> (node / 64)).is_multiple_of(7);
                Ok((0..).take(forest.nodes.len()).map(answer).collect())
            }))
        }),
    ];
    leaf.prop_recursive(3, 8, 3, |inner| {
        prop_oneof![
            prop::collection::vec(inner.clone(), 1..3).prop_map(Criterion::And),
            prop::collection::vec(inner.clone(), 1..3).prop_map(Criterion::Or),
            inner.prop_map(|part| Criterion::Not(Box::new(part))),
        ]
    })
}

/// How a camera moves on from where it was, and how its copy stands.
#[derive(Debug, Clone)]
struct Move {
    eye: DVec3,
    target: DVec3,
    is_parallel: bool,
    transform: DAffine3,
}

fn movement() -> impl Strategy<Value = Move> {
    let vector = |reach: f64| prop::array::uniform3(-reach..reach).prop_map(DVec3::from);
    let rows = prop::array::uniform3(prop::array::uniform3(-0.4_f64..0.4));
    (vector(25.0), vector(5.0), any::<bool>(), rows, prop::sample::select(vec![1.0, -1.0, 0.5]))
        .prop_map(|(eye, target, is_parallel, rows, sign)| {
            let skew = DMat3::from_cols_array_2d(&rows);
            let linear =
                (DMat3::IDENTITY + skew) * DMat3::from_diagonal(DVec3::new(sign, 1.0, 1.0));
            let transform = DAffine3::from_mat3_translation(linear, target * 0.3);
            Move { eye: eye + DVec3::splat(0.001), target, is_parallel, transform }
        })
}

/// Views that go on from one another in small steps, and what is asked of each.
fn walk() -> impl Strategy<Value = Vec<(Move, Criterion, Rule)>> {
    let leg = (
        movement(),
        prop::array::uniform3(-0.2_f64..0.2),
        criterion(),
        prop::sample::select(vec![Rule::Inclusive, Rule::Paper]),
        1..6_usize,
    );
    prop::collection::vec(leg, 1..4).prop_map(|legs| {
        let mut frames = Vec::new();
        for (start, step, criterion, rule, count) in legs {
            for frame in 0..count {
                let eye = start.eye + DVec3::from(step) * frame as f64;
                frames.push((Move { eye, ..start.clone() }, criterion.clone(), rule));
            }
        }
        frames
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2048))]

    #[test]
    fn followed_from_scratch_and_by_definition_are_the_same(
        forest in random_forest(60),
        frames in walk(),
        start in 0.0..=1.0_f64,
    ) {
        let order = DepthFirst::new(&forest);
        let mut cut = Cut::new(&forest, &order);
        let (fewest, most) = (forest.root_count(), forest.leaf_count as usize);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "few")]
        let leaf_count = fewest + (start * (most - fewest) as f64) as usize;
        cut.set_active(&order, uniform(&order, leaf_count).expect("in range")).expect("covers");
        for (at, criterion, rule) in frames {
            let projection = if at.is_parallel {
                Projection::Orthographic { height: 18.0 }
            } else {
                Projection::Perspective { fov_y: 0.9 }
            };
            let view = view_from(at.eye, at.target, projection);
            let placed = Placed { view: &view, world_from_local: at.transform };
            let zone = zone(&criterion, &forest, &order, &placed);
            let expected = naive(&forest, &order, &zone, rule);
            prop_assert_eq!(&scratch(&order, &zone, rule).0, &expected, "from scratch");
            let old = cut.active().to_vec();
            let steps = cut.update(&forest, &order, zone, rule);
            prop_assert_eq!(cut.active(), &expected[..], "followed");
            prop_assert!(covers(&forest, &expected), "{:?}", expected);
            let grown = (steps.split_count + steps.forced_split_count) as isize
                - (steps.collapse_count + steps.forced_collapse_count) as isize;
            prop_assert_eq!(expected.len() as isize - old.len() as isize, grown, "{:?}", steps);
            for (entry, node) in (0_u32..).zip(&expected) {
                let is_dirty = cut.changes().dirty.iter().any(|range| range.contains(&entry));
                prop_assert_eq!(is_dirty, old.get(entry as usize) != Some(node), "{}", entry);
            }
        }
    }

    #[test]
    fn what_is_said_of_a_sub_tree_holds_for_each_of_its_nodes(
        forest in random_forest(40),
        at in movement(),
        criterion in criterion(),
    ) {
        let order = DepthFirst::new(&forest);
        let projection = Projection::Perspective { fov_y: 0.9 };
        let view = view_from(at.eye, at.target, projection);
        let placed = Placed { view: &view, world_from_local: at.transform };
        let zone = zone(&criterion, &forest, &order, &placed);
        for (at, place) in order.places.iter().enumerate() {
            let (below, _) = zone.below(at, place);
            for node in at..place.end as usize {
                let (is_fine, _) = zone.holds(node, &order.places[node]);
                prop_assert!(below != Below::None || !is_fine, "{} below {}", node, at);
                prop_assert!(below != Below::All || is_fine, "{} below {}", node, at);
            }
        }
    }
}

#[test]
fn the_check_of_covers_can_fail() {
    let forest = five();
    assert!(covers(&forest, &[4, 5, 2, 3]), "each leaf once");
    assert!(!covers(&forest, &[5, 2, 3]), "leaf 4 is not there");
    assert!(!covers(&forest, &[4, 7, 0]), "leaf 0 is there twice");
}
