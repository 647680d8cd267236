//! Where each node stands when the forest is walked depth first, and what a walk asks there.
//!
//! Trees follow one another by the index of their roots; a node comes before what lies below it, its
//! first child before its second. The nodes of a sub-tree then are a range of places, its leaves a
//! range of the leaves in their order, and every level of detail is a list of ascending places. A
//! walk needs no recursion: after a sub-tree, go on at its end.
//!
//! O(nodes) time; 40 bytes a node, and 4 for a place by node. Derived, so never stored.

use glam::{DVec3, Vec3};

use crate::lod::foliage_hierarchy::forest::{Forest, NONE, Sphere};
use crate::lod::foliage_hierarchy::quad::measure;

/// Share by which a forest's balls are widened: more than their rounding to 32 bits takes away.
const WIDENING: f64 = 1e-6;

/// A node in its place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Which node.
    pub node: u32,
    /// The place behind the last node below it.
    pub end: u32,
    /// Leaves in places before it.
    pub first_leaf: u32,
    /// Centre of its own quad as drawn.
    pub center: Vec3,
    /// The forest's ball around it and what lies below it.
    pub ball: Sphere,
    /// Around the ball's centre: within this lie the centres of its quad and of all quads below.
    pub center_reach: f32,
    /// Around the ball's centre: within this lie its ball and all balls below.
    pub ball_reach: f32,
    /// Least radius of its ball and all balls below.
    pub least_radius: f32,
}

/// A forest in depth-first order.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthFirst {
    /// Nodes in their order.
    pub places: Vec<Place>,
    /// Place of each node.
    pub place_of: Vec<u32>,
    /// Leaves in their order.
    pub leaves: Vec<u32>,
    /// Trees.
    pub root_count: usize,
    /// Around everything that any question is about.
    pub crown: (DVec3, f64),
}

impl DepthFirst {
    /// Walks a forest whose links hold.
    pub fn new(forest: &Forest) -> Self {
        let place_of = places(forest);
        let mut order = vec![0; forest.nodes.len()];
        for (&place, node) in place_of.iter().zip(0_u32..) {
            order[place as usize] = node;
        }
        let mut leaves = Vec::with_capacity(forest.leaf_count as usize);
        let mut places = Vec::with_capacity(order.len());
        for &node in &order {
            let ball = forest.spheres[node as usize];
            places.push(Place {
                node,
                end: 0,
                first_leaf: index(leaves.len()),
                center: measure(&forest.quad(node)).center.as_vec3(),
                ball,
                center_reach: 0.0,
                ball_reach: 0.0,
                least_radius: ball.radius,
            });
            if forest.nodes[node as usize].is_leaf() {
                leaves.push(node);
            }
        }
        let mut order = Self {
            places,
            place_of,
            leaves,
            root_count: forest.root_count(),
            crown: (DVec3::ZERO, 0.0),
        };
        order.measure_sub_trees(forest);
        order.crown = order.around_roots();
        order
    }

    /// Leaves at a place and below it, as a range of [`DepthFirst::leaves`].
    pub fn leaves_below(&self, place: usize) -> &[u32] {
        let Place { first_leaf, end, .. } = self.places[place];
        let end =
            self.places.get(end as usize).map_or(self.leaves.len(), |p| p.first_leaf as usize);
        &self.leaves[first_leaf as usize..end]
    }

    /// Whether no other node lies below a place.
    pub fn is_leaf(&self, place: usize) -> bool {
        self.places[place].end as usize == place + 1
    }

    /// Places of the roots, in order.
    pub fn roots(&self) -> impl Iterator<Item = usize> {
        let first = (!self.places.is_empty()).then_some(0);
        let next = |&place: &usize| {
            Some(self.places[place].end as usize).filter(|&next| next < self.places.len())
        };
        std::iter::successors(first, next)
    }

    /// From the last place to the first, so children before parents.
    fn measure_sub_trees(&mut self, forest: &Forest) {
        for at in (0..self.places.len()).rev() {
            let mut place = self.places[at];
            let (middle, radius) = (place.ball.center.as_dvec3(), f64::from(place.ball.radius));
            let mut center_reach = middle.distance(place.center.as_dvec3());
            let mut ball_reach = radius;
            place.end = index(at + 1);
            let children = forest.nodes[place.node as usize].children;
            for child in children.into_iter().filter(|&child| child != NONE) {
                let below = &self.places[self.place_of[child as usize] as usize];
                let way = middle.distance(below.ball.center.as_dvec3());
                center_reach = center_reach.max(way + f64::from(below.center_reach));
                ball_reach = ball_reach.max(way + f64::from(below.ball_reach));
                place.least_radius = place.least_radius.min(below.least_radius);
                place.end = place.end.max(below.end);
            }
            // the forest's ball holds all quads, and so their centres, but for its rounding
            let coordinates = place.ball.center.as_dvec3().abs().max_element();
            let widened = radius + (radius + coordinates) * WIDENING;
            place.center_reach = upward(center_reach.min(widened));
            place.ball_reach = upward(ball_reach);
            self.places[at] = place;
        }
    }

    /// A ball around the balls of all trees, and the centres of their quads.
    fn around_roots(&self) -> (DVec3, f64) {
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for place in self.roots().map(|root| &self.places[root]) {
            let middle = place.ball.center.as_dvec3();
            let reach = f64::from(place.ball_reach.max(place.center_reach));
            low = low.min(middle - reach);
            high = high.max(middle + reach);
        }
        if self.places.is_empty() {
            return (DVec3::ZERO, 0.0);
        }
        ((low + high) * 0.5, (high - low).length() * 0.5)
    }
}

/// Place of each node: parents have higher indices than children, so sizes are summed upwards and
/// places handed down.
fn places(forest: &Forest) -> Vec<u32> {
    let mut sizes = vec![1_u32; forest.nodes.len()];
    for (at, node) in forest.nodes.iter().enumerate() {
        if node.parent != NONE {
            sizes[node.parent as usize] += sizes[at];
        }
    }
    let mut places = vec![0_u32; forest.nodes.len()];
    let mut next = 0;
    for root in forest.roots() {
        places[root as usize] = next;
        next += sizes[root as usize];
    }
    for (at, node) in forest.nodes.iter().enumerate().rev() {
        if !node.is_leaf() {
            let [first, second] = node.children.map(|child| child as usize);
            places[first] = places[at] + 1;
            places[second] = places[at] + 1 + sizes[first];
        }
    }
    places
}

fn index(count: usize) -> u32 {
    u32::try_from(count).expect("a forest's nodes are counted in 32 bits")
}

/// The least f32 that is not below a number.
fn upward(value: f64) -> f32 {
    #[expect(clippy::cast_possible_truncation, reason = "rounded up where it was rounded down")]
    let rounded = value as f32;
    if f64::from(rounded) < value { rounded.next_up() } else { rounded }
}
