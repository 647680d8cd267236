use proptest::prelude::*;

use super::*;
use crate::job;
use crate::lod::leaf_clusters::misses::{Miss, misses};
use crate::random::{Purpose, Stream};

/// Of `L (R^2 + alpha)`: what rounding may raise the error by in a turn.
const RISE: f64 = 1e-12;

/// Leaves of all directions in a ball of radius 5.
fn crown(count: usize, seed: u64) -> (Vec<Vec3>, Vec<Vec3>) {
    let mut stream = Stream::new(seed, Purpose::named("test.crown"), 0);
    let mut vector = || loop {
        let v = DVec3::new(stream.signed(), stream.signed(), stream.signed());
        if v.length() <= 1.0 && v.length() > 0.1 {
            return v;
        }
    };
    (0..count).map(|_| ((vector() * 5.0).as_vec3(), vector().normalize().as_vec3())).unzip()
}

fn params(cluster_count: usize, alpha: f64) -> Params {
    Params {
        cluster_count,
        alpha,
        init: Init::PlusPlus,
        seed: 1,
        restarts: 1,
        max_iterations: 100,
        eigen: Eigen::Exact,
    }
}

fn found(centers: &[Vec3], normals: &[Vec3], params: &Params) -> Clustering {
    cluster(centers, normals, params, &Job::default()).expect("valid")
}

/// Planes across y at these heights, with the sign that planes have.
fn floors(heights: &[f64]) -> Vec<Plane> {
    heights.iter().map(|&y| Plane::through(DVec3::Y * y, DVec3::Y)).collect()
}

fn given(planes: Vec<Plane>, alpha: f64) -> Params {
    Params { init: Init::Planes(planes.clone()), ..params(planes.len(), alpha) }
}

/// Leaves at these heights, three each, that lie flat.
fn flat(heights: &[f32]) -> (Vec<Vec3>, Vec<Vec3>) {
    let corners = [Vec3::ZERO, Vec3::X, Vec3::Z];
    let at = |&y: &f32| corners.map(|corner| corner + Vec3::Y * y);
    let centers: Vec<Vec3> = heights.iter().flat_map(at).collect();
    let normals = vec![Vec3::Y; centers.len()];
    (centers, normals)
}

#[test]
fn three_floors_by_hand() {
    //  y
    //  4  ---  c            planes start at 0.5 and 3: a goes to the first, c to the second,
    //  2  ---  b            b is nearer to 3
    //  0  ---  a
    let (centers, normals) = flat(&[0.0, 2.0, 4.0]);
    let got = found(&centers, &normals, &given(floors(&[0.5, 3.0]), 1.0));
    assert_eq!(got.cluster_ids, [0, 0, 0, 1, 1, 1, 1, 1, 1], "b and c together");
    assert_eq!(got.planes, floors(&[0.0, 3.0]), "fitted");
    assert_eq!(got.errors, [6.0, 6.0], "six leaves are 1 off; nothing changed in the second turn");
    assert_eq!((got.iteration_count, got.converged), (2, true), "two turns");
    assert_eq!(got.moments[0].count, 3, "three in a");
    assert_eq!(got.moments[1].mean.y, 3.0, "between b and c");
}

#[test]
fn ties_go_to_the_lower_id() {
    // the leaves in the middle are as far from the one plane as from the other
    let (centers, normals) = flat(&[0.0, 2.0, 4.0]);
    for heights in [[0.0, 4.0], [4.0, 0.0]] {
        let start = given(floors(&heights), 1.0);
        for method in [Method::Pruned, Method::Full, Method::Naive] {
            for level in Level::all() {
                let got = cluster_by(method, level, &centers, &normals, &start, &Job::default());
                let ids = got.expect("valid").cluster_ids;
                assert_eq!(ids[3..6], [0; 3], "{heights:?} {method:?} {level:?}");
            }
        }
    }
    // equal planes: all leaves to the first, and the second takes the worst leaf
    let got = found(&centers, &normals, &given(floors(&[2.0, 2.0, 2.0]), 1.0));
    assert_eq!(got.planes.len(), 3, "three floors, three planes");
    assert_eq!(got.errors.last(), Some(&0.0), "each its own floor");
}

#[test]
fn an_empty_cluster_takes_the_worst_leaf_and_several_the_next() {
    //  heights 0 0 0 1 5 9, plane 0 at height 0, planes 1 and 2 far away
    let centers = [0.0, 0.0, 0.0, 1.0, 5.0, 9.0].map(|y| Vec3::new(0.0, y, 0.0));
    let turn = |max_iterations| Params { max_iterations, ..given(floors(&[0.0, 1e3, 2e3]), 0.0) };
    let got = found(&centers, &[Vec3::Y; 6], &turn(1));
    assert_eq!(got.cluster_ids, [0, 0, 0, 0, 2, 1], "9 is worst, then 5");
    assert!(!got.converged, "one turn is not enough to know");
    // equal errors: the lower index first
    let centers = [0.0, 4.0, -4.0].map(|y| Vec3::new(0.0, y, 0.0));
    let got = found(&centers, &[Vec3::Y; 3], &turn(1));
    assert_eq!(got.cluster_ids, [0, 1, 2], "leaf 1 before leaf 2");
}

#[test]
fn clusters_that_nothing_is_left_for_are_dropped() {
    let (centers, normals) = flat(&[1.0, 2.0]);
    let got = found(&centers, &normals, &given(floors(&[9.0, 2.0, 8.0, 1.0, 7.0]), 1.0));
    assert_eq!(got.cluster_ids, [1, 1, 1, 0, 0, 0], "ids close up in order");
    assert_eq!(got.planes, floors(&[2.0, 1.0]), "two floors, two planes");
    assert_eq!(got.moments.len(), 2, "moments too");
    assert!(got.converged, "and it ends");
}

#[test]
fn few_leaves_and_many_clusters() {
    for init in [Init::Random, Init::PlusPlus] {
        let many = Params { init, ..params(7, 0.5) };
        let one = found(&[Vec3::X * 2.0], &[Vec3::X], &many);
        assert_eq!(one.cluster_ids, [0], "one leaf, one cluster");
        assert_eq!(one.planes, [Plane { normal: -Vec3::X.as_dvec3(), d: 2.0 }], "its own plane");
        let two = found(&[Vec3::X; 2], &[Vec3::X; 2], &many);
        assert_eq!((two.planes.len(), &two.cluster_ids[..]), (1, &[0, 0][..]), "equal leaves");
        let (centers, normals) = crown(5, 3);
        let got = found(&centers, &normals, &many);
        assert_eq!(got.planes.len(), 5, "a plane for each");
        let rise = RISE * 5.0 * (25.0 + 0.5);
        assert!(got.errors[got.iteration_count - 1] < rise, "{:?}", got.errors);
    }
}

#[test]
fn leaves_without_a_normal_go_by_distance_alone() {
    let (centers, _) = flat(&[0.0, 5.0]);
    let got = found(&centers, &[Vec3::ZERO; 6], &params(2, 3.0));
    assert_eq!(got.errors.last(), Some(&0.0), "two floors");
    assert_eq!(got.moments[0].facing, glam::DMat3::ZERO, "no normals");
}

#[test]
fn ids_to_start_from_are_kept_where_they_are_right() {
    let (centers, normals) = flat(&[0.0, 5.0, 9.0]);
    let ids = vec![2, 2, 2, 0, 0, 0, 1, 1, 1];
    let start = Params { init: Init::Ids(ids.clone()), ..params(3, 1.0) };
    let got = found(&centers, &normals, &start);
    assert_eq!((got.cluster_ids, got.iteration_count), (ids, 1), "nothing changes");
    assert_eq!(got.planes, floors(&[5.0, 9.0, 0.0]), "fitted");
    // an id that none has takes the worst leaf
    let start = Params { init: Init::Ids(vec![0; 9]), ..params(3, 1.0) };
    assert_eq!(found(&centers, &normals, &start).errors.last(), Some(&0.0), "three floors");
}

#[test]
fn all_ways_give_the_same() {
    let job = Job::default();
    for count in [1, 2, 8, 9, 63, 65, 1023, 1024, 1025, 2500] {
        let (centers, normals) = crown(count, 7);
        for (cluster_count, alpha) in [(1, 0.1), (3, 0.0), (32, 2.5), (40, 1e6), (130, 0.3)] {
            let params = params(cluster_count, alpha);
            let by = |method, level, threads| {
                job::run(Some(threads), || {
                    cluster_by(method, level, &centers, &normals, &params, &job)
                })
                .expect("valid")
            };
            let naive = by(Method::Naive, Level::all()[0], 1);
            for level in Level::all() {
                for (method, threads) in
                    [(Method::Full, 1), (Method::Pruned, 1), (Method::Pruned, 3)]
                {
                    let got = by(method, level, threads);
                    assert_eq!(
                        got, naive,
                        "{count} leaves, {cluster_count} planes, {alpha}: {method:?} {level:?} {threads}"
                    );
                }
            }
        }
    }
}

#[test]
fn sizes_and_places_do_not_show() {
    let (centers, normals) = crown(500, 5);
    // multiples of 2^-6, which a place of 2^17 leaves whole
    let centers: Vec<Vec3> = centers.iter().map(|p| (*p * 64.0).round() / 64.0).collect();
    let start = Init::Planes(floors(&[-4.0, -1.0, 0.5, 3.0]));
    let base = found(&centers, &normals, &Params { init: start.clone(), ..params(4, 2.0) });
    let away = Vec3::new(131_072.0, -65_536.0, 98_304.0);
    let moved: Vec<Vec3> = centers.iter().map(|p| *p + away).collect();
    let planes = |by: &dyn Fn(&Plane) -> Plane| match &start {
        Init::Planes(planes) => Init::Planes(planes.iter().map(by).collect()),
        _ => unreachable!("planes were given"),
    };
    let there = planes(&|plane| plane.relative_to(-away.as_dvec3()));
    let got = found(&moved, &normals, &Params { init: there, ..params(4, 2.0) });
    assert_eq!(
        (got.cluster_ids, got.errors),
        (base.cluster_ids.clone(), base.errors.clone()),
        "far"
    );
    for scale in [2.0_f32.powi(-16), 2.0_f32.powi(11)] {
        let scaled: Vec<Vec3> = centers.iter().map(|p| *p * scale).collect();
        let wide = f64::from(scale);
        let there = planes(&|plane| Plane { d: plane.d * wide, ..*plane });
        let got = found(&scaled, &normals, &Params { init: there, ..params(4, 2.0 * wide * wide) });
        assert_eq!(got.cluster_ids, base.cluster_ids, "scaled by {scale}");
    }
}

#[test]
fn restarts_take_the_best_and_of_equals_the_first() {
    let (centers, normals) = crown(60, 2);
    let mut better_count = 0;
    for seed in 0..8 {
        let tried =
            |restarts| found(&centers, &normals, &Params { restarts, seed, ..params(6, 2.0) });
        let errors: Vec<f64> =
            (1..=4).map(|restarts| *tried(restarts).errors.last().expect("a turn")).collect();
        assert!(errors.windows(2).all(|pair| pair[1] <= pair[0]), "never worse: {errors:?}");
        better_count += usize::from(errors[3] < errors[0]);
    }
    assert!(better_count > 0, "no other start was ever better than the first");
    let alone = found(&centers, &normals, &params(1, 2.0));
    let again = found(&centers, &normals, &Params { restarts: 3, ..params(1, 2.0) });
    assert_eq!(alone, again, "one cluster always ends alike: the first");
}

#[test]
fn the_papers_planes_are_never_better_and_much_worse_where_angles_weigh_much() {
    let (centers, normals) = crown(300, 4);
    for (alpha, least) in [(0.01, 1.0), (250.0, 1.5)] {
        let got = found(&centers, &normals, &params(8, alpha));
        let ids = &got.cluster_ids;
        let misses = misses(&centers, &normals, ids, 9, alpha, &Job::default()).expect("valid");
        for (cluster, miss) in misses.iter().enumerate().take(8) {
            assert_eq!(miss.best, got.planes[cluster], "the plane of cluster {cluster}");
            assert_eq!(miss.leaf_count, got.moments[cluster].count, "leaves of {cluster}");
            assert!(miss.paper_cost >= miss.best_cost * (1.0 - 1e-12), "{cluster}: {miss:?}");
        }
        let [paper, best] = [|miss: &Miss| miss.paper_cost, |miss: &Miss| miss.best_cost]
            .map(|cost| misses.iter().map(cost).sum::<f64>());
        assert!(paper >= least * best * (1.0 - 1e-12), "alpha {alpha}: {paper}, {best}");
        assert!((best / got.errors[got.iteration_count - 1] - 1.0).abs() < 1e-12, "same sum");
        assert_eq!(
            (misses[8].leaf_count, misses[8].best_cost),
            (0, 0.0),
            "a cluster without leaves"
        );
    }
    // where the paper's planes are used all along, errors may rise, and still all leaves have a plane
    let paper = found(&centers, &normals, &Params { eigen: Eigen::Paper, ..params(8, 250.0) });
    assert!(paper.cluster_ids.iter().all(|&id| (id as usize) < paper.planes.len()), "all");
}

#[test]
fn what_is_wrong_is_named() {
    let (centers, normals) = crown(4, 1);
    let job = Job::default();
    let text = |centers: &[Vec3], normals: &[Vec3], params: &Params| {
        cluster(centers, normals, params, &job).expect_err("refused").to_string()
    };
    let good = params(2, 1.0);
    assert!(text(&[], &[], &good).starts_with("centers is empty"), "no leaves");
    assert!(text(&centers, &normals[1..], &good).starts_with("normals: must be as many"), "fewer");
    let mut bad = centers.clone();
    bad[2].y = f32::NAN;
    assert_eq!(text(&bad, &normals, &good), "centers must be finite: element 2 is not", "NaN");
    let mut bad = normals.clone();
    bad[3] *= 1.01;
    assert!(text(&centers, &bad, &good).starts_with("normals: must have length 1 or 0"), "long");
    let tilted = |normal: DVec3, d: f64| Init::Planes(vec![Plane { normal, d }; 2]);
    for (start, params) in [
        ("cluster_count must be in", params(0, 1.0)),
        ("cluster_count must be in", params(MAX_CLUSTER_COUNT + 1, 1.0)),
        ("alpha must be in", params(2, -1e-9)),
        ("alpha must be in", params(2, f64::NAN)),
        ("alpha must be in", params(2, 1e13)),
        ("restarts must be in", Params { restarts: 0, ..good.clone() }),
        ("max_iterations must be in", Params { max_iterations: 0, ..good.clone() }),
        ("init: must hold cluster", Params { init: Init::Planes(floors(&[1.0])), ..good.clone() }),
        ("init: normals", Params { init: tilted(DVec3::Y * 2.0, 0.0), ..good.clone() }),
        ("init must be finite", Params { init: tilted(DVec3::Y, f64::NAN), ..good.clone() }),
        ("init must be finite", Params { init: tilted(DVec3::NAN, 0.0), ..good.clone() }),
        ("init: must hold an id", Params { init: Init::Ids(vec![0; 3]), ..good.clone() }),
        ("init: ids must be", Params { init: Init::Ids(vec![0, 1, 2, 0]), ..good.clone() }),
        (
            "restarts: must be 1",
            Params { init: Init::Ids(vec![0; 4]), restarts: 2, ..good.clone() },
        ),
    ] {
        let text = text(&centers, &normals, &params);
        assert!(text.starts_with(start), "{start}: {text}");
    }
}

#[test]
fn it_can_be_stopped_and_says_how_far_it_is() {
    let (centers, normals) = crown(50, 1);
    let job = Job::default();
    let twice = Params { restarts: 2, ..params(3, 1.0) };
    cluster(&centers, &normals, &twice, &job).expect("valid");
    assert_eq!(job.progress(), (200, 200), "turns that were not needed count as done");
    job.cancel();
    let stopped = cluster(&centers, &normals, &twice, &job);
    assert_eq!(stopped, Err(LodError::Cancelled), "cancelled");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn errors_fall_to_a_fixed_point(
        count in 1..300_usize, seed in 0..1000_u64, cluster_count in 1..12_usize,
        alpha in prop::sample::select(vec![0.0, 1e-3, 0.3, 2.5, 50.0, 1e6]),
        init in prop::sample::select(vec![Init::Random, Init::PlusPlus])
    ) {
        let (centers, normals) = crown(count, seed);
        let params = Params { init, ..params(cluster_count, alpha) };
        let got = found(&centers, &normals, &params);
        let rise = RISE * count as f64 * (25.0 + alpha);
        prop_assert!(got.errors.windows(2).all(|pair| pair[1] <= pair[0] + rise), "{:?}", got.errors);
        // what is stated is what the leaves have
        let sum: f64 = got.cluster_ids.iter().zip(centers.iter().zip(&normals)).map(|(&id, (p, n))| {
            got.planes[id as usize].error(p.as_dvec3(), n.as_dvec3(), alpha)
        }).sum();
        let last = got.errors[got.iteration_count - 1];
        prop_assert!((sum - last).abs() <= rise, "{sum} {last}");
        let counts: Vec<u64> = got.moments.iter().map(|moments| moments.count).collect();
        prop_assert!(counts.iter().all(|&count| count > 0));
        prop_assert_eq!(counts.iter().sum::<u64>(), count as u64);
        // nothing is left to do
        if got.converged && last > 1e3 * rise {
            let start = Init::Ids(got.cluster_ids.clone());
            let again = found(&centers, &normals, &Params { init: start, cluster_count: got.planes.len(), ..params });
            prop_assert!(again.errors[0] >= last * (1.0 - 1e-11) - rise, "{:?} {last}", again.errors);
        }
    }

    #[test]
    fn leaves_in_another_order_have_the_same_clusters(
        count in 2..200_usize, seed in 0..1000_u64, alpha in prop::sample::select(vec![0.0, 0.5, 1e3])
    ) {
        let (centers, normals) = crown(count, seed);
        let start = given(floors(&[-4.0, -1.5, 0.0, 2.0, 4.5]), alpha);
        let got = found(&centers, &normals, &start);
        // 7919 is a prime, and larger than any count
        let order: Vec<usize> = (0..count).map(|i| (i * 7919 + 5) % count).collect();
        let pick = |rows: &[Vec3]| -> Vec<Vec3> { order.iter().map(|&i| rows[i]).collect() };
        let turned = found(&pick(&centers), &pick(&normals), &start);
        // empty clusters take leaves by their index, so only what had none is compared
        prop_assert_eq!(&turned.errors, &got.errors);
        prop_assert_eq!(&turned.planes, &got.planes);
        for (slot, &leaf) in order.iter().enumerate() {
            prop_assert_eq!(turned.cluster_ids[slot], got.cluster_ids[leaf]);
        }
    }
}
