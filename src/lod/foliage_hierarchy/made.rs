//! Tiny hand-made forests, and random ones, for the tests.

use glam::{DVec3, Vec3};
use proptest::prelude::*;

use crate::lod::foliage_hierarchy::forest::{Forest, NONE, Node, Sphere, TextureCorners};
use crate::lod::foliage_hierarchy::quad::measure;

/// A forest in the making: leaves, then collapses of any two that have no parent.
#[derive(Debug)]
pub(crate) struct Maker {
    forest: Forest,
}

impl Maker {
    pub(crate) fn new(leaves: &[[Vec3; 4]]) -> Self {
        let leaf_count = u32::try_from(leaves.len()).expect("few");
        let mut maker = Self {
            forest: Forest {
                leaf_count,
                positions: leaves.iter().flatten().copied().collect(),
                nodes: Vec::new(),
                spheres: Vec::new(),
                costs: Vec::new(),
                areas: Vec::new(),
                scales: Vec::new(),
                corners: Vec::new(),
            },
        };
        for leaf in 0..leaf_count {
            let vertices = [0, 1, 2, 3].map(|corner| 4 * leaf + corner);
            maker.add(Node { vertices, parent: NONE, children: [NONE; 2] }, 1.0);
            let area = measure(&maker.forest.quad(leaf)).area;
            maker.forest.areas.push(area);
            maker.forest.corners.push(TextureCorners { leaf, turn: 0 });
        }
        maker
    }

    /// Collapses two nodes; the corners are two of each, chosen by the bits of `choice`.
    pub(crate) fn collapse(&mut self, pair: [u32; 2], choice: u8, scale: f32) {
        let [first, second] = [pair[0].min(pair[1]), pair[0].max(pair[1])];
        let made = u32::try_from(self.forest.nodes.len()).expect("few");
        let [a, b] = [first, second].map(|child| {
            assert_eq!(self.forest.nodes[child as usize].parent, NONE, "{child} is free");
            self.forest.nodes[child as usize].parent = made;
            self.forest.nodes[child as usize].vertices
        });
        let (at_a, at_b) = (usize::from(choice & 3), usize::from(choice >> 2 & 3));
        let vertices = [a[at_a], a[(at_a + 1) % 4], b[at_b], b[(at_b + 1) % 4]];
        self.forest.costs.push(f64::from(made));
        self.forest
            .areas
            .push(self.forest.areas[first as usize] + self.forest.areas[second as usize]);
        self.forest.corners.push(TextureCorners {
            leaf: self.forest.corners[first as usize].leaf,
            turn: u32::from(choice & 3),
        });
        self.add(Node { vertices, parent: NONE, children: [first, second] }, scale);
    }

    fn add(&mut self, node: Node, scale: f32) {
        let index = u32::try_from(self.forest.nodes.len()).expect("few");
        self.forest.nodes.push(node);
        self.forest.scales.push(scale);
        let corners = self.forest.drawn_quad(index);
        let below: Vec<Sphere> = node
            .children
            .iter()
            .filter(|&&child| child != NONE)
            .map(|&child| self.forest.spheres[child as usize])
            .collect();
        let center = if below.is_empty() {
            measure(&corners).center
        } else {
            below.iter().map(|ball| ball.center.as_dvec3()).sum::<DVec3>() / below.len() as f64
        };
        let center = center.as_vec3();
        let reach = below
            .iter()
            .map(|ball| (ball.center.as_dvec3(), f64::from(ball.radius)))
            .chain(corners.map(|corner| (corner, 0.0)))
            .map(|(point, radius)| center.as_dvec3().distance(point) + radius)
            .fold(0.0, f64::max);
        #[expect(clippy::cast_possible_truncation, reason = "rounded up")]
        let radius = (reach as f32).next_up();
        self.forest.spheres.push(Sphere { center, radius });
    }

    pub(crate) fn finish(self) -> Forest {
        self.forest
    }
}

/// A square of 1 m in a plane of constant z.
pub(crate) fn square(center: Vec3) -> [Vec3; 4] {
    [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)].map(|(x, y)| center + Vec3::new(x, y, 0.0))
}

/// Unit squares at x = 0, 2, 4 ..., collapsed as told.
pub(crate) fn forest(leaf_count: usize, pairs: &[[u32; 2]]) -> Forest {
    let leaves: Vec<_> = (0..leaf_count).map(|leaf| square(Vec3::X * (2 * leaf) as f32)).collect();
    let mut maker = Maker::new(&leaves);
    for &pair in pairs {
        maker.collapse(pair, 0, 1.0);
    }
    maker.finish()
}

/// Each collapse takes in one more leaf: as deep as it has leaves.
pub(crate) fn chain(leaf_count: u32) -> Forest {
    let pairs: Vec<[u32; 2]> =
        (1..leaf_count).map(|t| [if t == 1 { 0 } else { leaf_count + t - 2 }, t]).collect();
    forest(leaf_count as usize, &pairs)
}

/// Random squares in a crown of 20 m, collapsed in random pairs down to a random number of roots.
pub(crate) fn random_forest(max_leaf_count: usize) -> impl Strategy<Value = Forest> {
    let corner = prop::array::uniform3(-1.0_f32..1.0);
    let leaf = (prop::array::uniform3(-10.0_f32..10.0), prop::array::uniform4(corner));
    let collapse = (any::<prop::sample::Index>(), any::<prop::sample::Index>(), 0..16_u8, 0..4_u8);
    prop::collection::vec((leaf, collapse), 1..=max_leaf_count)
        .prop_flat_map(|rows| (0..rows.len(), Just(rows)))
        .prop_map(|(collapse_count, rows)| {
            let leaves: Vec<[Vec3; 4]> = rows
                .iter()
                .map(|((center, corners), _)| corners.map(|c| Vec3::from(*center) + Vec3::from(c)))
                .collect();
            let mut maker = Maker::new(&leaves);
            let mut free: Vec<u32> = (0..).take(leaves.len()).collect();
            for (_, (first, second, choice, scale)) in rows.iter().take(collapse_count) {
                let first = free.swap_remove(first.index(free.len()));
                let second = free.swap_remove(second.index(free.len()));
                maker.collapse([first, second], *choice, 1.0 + f32::from(*scale) * 0.25);
                free.push(u32::try_from(maker.forest.nodes.len() - 1).expect("few"));
            }
            maker.finish()
        })
}
