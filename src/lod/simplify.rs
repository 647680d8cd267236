//! meshoptimizer on a part of a plant: fewer triangles of the same vertices, and what that costs.
//!
//! Only the order of triangles and their corners change; vertices stay where they are, with their
//! normals, texture coordinates and lit colours. Each material is simplified by itself, so that none
//! takes another's triangles.
//!
//! meshoptimizer is one call into C++ that cannot be interrupted and takes about a second for a
//! million triangles. It runs on a thread of its own, on copies: a cancelled job leaves it behind, and
//! what it finds is thrown away.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use crate::error::LodError;
use crate::job::Job;
use crate::plant::Mesh;

/// How often the job is looked at while meshoptimizer works.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Vertex attributes that count beside the position: a normal's three numbers and two coordinates.
const ATTRIBUTE_COUNT: usize = 5;

/// Which of meshoptimizer's simplifiers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Method {
    /// `meshopt_simplify`: collapses edges by their quadric error and keeps the topology.
    Edges(EdgeOptions),
    /// `meshopt_simplifyWithAttributes`: as `Edges`, and normals and texture coordinates count.
    Attributes {
        /// What both share.
        options: EdgeOptions,
        /// Of each of a normal's three numbers, against a length of the foliage's largest side.
        normal_weight: f32,
        /// Of both texture coordinates, against the same.
        uv_weight: f32,
    },
    /// `meshopt_simplifySloppy`: vertices that share a cell of a grid become one.
    Sloppy,
}

/// What edge collapses may do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EdgeOptions {
    /// Whether pieces that are smaller than the error are dropped whole.
    pub prune: bool,
    /// Whether vertices on open borders stay where they are.
    pub lock_border: bool,
}

/// The simplified triangles of one material.
#[derive(Debug, Clone, PartialEq)]
pub struct Simplified {
    /// Into the mesh's vertices.
    pub triangles: Vec<[u32; 3]>,
    /// meshoptimizer's error in metres.
    pub error: f64,
}

/// A mesh as meshoptimizer reads it.
#[derive(Debug, Clone)]
pub struct Simplifier {
    positions: Arc<[[f32; 3]]>,
    attributes: Arc<[[f32; ATTRIBUTE_COUNT]]>,
}

impl Simplifier {
    /// Takes copies of what counts of a mesh.
    pub fn new(mesh: &Mesh) -> Self {
        let attributes = mesh.normals.iter().zip(&mesh.uvs);
        Self {
            positions: mesh.positions.iter().map(|p| p.to_array()).collect(),
            attributes: attributes.map(|(n, uv)| [n.x, n.y, n.z, uv.x, uv.y]).collect(),
        }
    }

    /// About `target_count` of some triangles, or as few as `max_error` metres allow.
    ///
    /// There may be more where the topology allows no further step, and fewer where a step takes
    /// several triangles with it.
    ///
    /// # Errors
    /// [`LodError::Cancelled`].
    pub fn simplify(
        &self,
        triangles: &[[u32; 3]],
        target_count: usize,
        max_error: f64,
        method: Method,
        job: &Job,
    ) -> Result<Simplified, LodError> {
        if target_count >= triangles.len() {
            return Ok(Simplified { triangles: triangles.to_vec(), error: 0.0 });
        }
        let (triangles, own) = (triangles.to_vec(), self.clone());
        waited_for(job, move || own.call(&triangles, target_count, max_error, method))
    }

    /// `target_count` is below the count that there is: meshoptimizer ends the process otherwise.
    fn call(
        &self,
        triangles: &[[u32; 3]],
        target_count: usize,
        max_error: f64,
        method: Method,
    ) -> Simplified {
        assert!(target_count < triangles.len(), "meshoptimizer would end the process");
        let bytes = bytemuck::cast_slice(&self.positions);
        let vertices = meshopt::VertexDataAdapter::new(bytes, size_of::<[f32; 3]>(), 0)
            .expect("whole vertices of three floats");
        let indices = triangles.as_flattened();
        let target = target_count * 3;
        #[expect(clippy::cast_possible_truncation, reason = "rounded, and never too large")]
        let absolute = max_error.clamp(0.0, f64::from(f32::MAX).sqrt()) as f32;
        let mut error = 0.0;
        let (kept, scale) = match method {
            Method::Edges(options) => {
                let options = options.flags();
                let error = Some(&mut error);
                (meshopt::simplify(indices, &vertices, target, absolute, options, error), 1.0)
            }
            Method::Attributes { options, normal_weight, uv_weight } => {
                let [n, t] = [normal_weight, uv_weight];
                let weights = [n, n, n, t, t];
                let unlocked = vec![false; self.positions.len()];
                let kept = meshopt::simplify_with_attributes_and_locks(
                    indices,
                    &vertices,
                    self.attributes.as_flattened(),
                    &weights,
                    size_of::<[f32; ATTRIBUTE_COUNT]>(),
                    &unlocked,
                    target,
                    absolute,
                    options.flags(),
                    Some(&mut error),
                );
                (kept, 1.0)
            }
            Method::Sloppy => {
                // the one that knows no absolute error
                let scale = meshopt::simplify_scale(&vertices);
                let relative = if scale > 0.0 { (absolute / scale).min(1.0) } else { 1.0 };
                let error = Some(&mut error);
                (meshopt::simplify_sloppy(indices, &vertices, target, relative, error), scale)
            }
        };
        let (corners, rest) = kept.as_chunks::<3>();
        assert!(rest.is_empty(), "whole triangles");
        Simplified { triangles: corners.to_vec(), error: f64::from(error) * f64::from(scale) }
    }
}

impl EdgeOptions {
    fn flags(self) -> meshopt::SimplifyOptions {
        let mut flags = meshopt::SimplifyOptions::ErrorAbsolute;
        flags.set(meshopt::SimplifyOptions::Prune, self.prune);
        flags.set(meshopt::SimplifyOptions::LockBorder, self.lock_border);
        flags
    }
}

/// Runs what cannot be stopped on a thread that is left behind when the job is cancelled.
fn waited_for<T: Send + 'static>(
    job: &Job,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, LodError> {
    job.check()?;
    let (sender, receiver) = mpsc::channel();
    let spawned = thread::Builder::new().name("treelod-meshopt".to_owned()).spawn(move || {
        // fails only if the job was cancelled, and then nobody wants the result
        let _ = sender.send(work());
    });
    let worker = spawned.map_err(|error| LodError::Invalid {
        name: "threads",
        why: format!("the system gave no thread to simplify on: {error}"),
    })?;
    loop {
        match receiver.recv_timeout(POLL_INTERVAL) {
            Ok(result) => return Ok(result),
            Err(RecvTimeoutError::Timeout) => job.check()?,
            Err(RecvTimeoutError::Disconnected) => {
                let panic = worker.join().expect_err("it sends unless it panics");
                std::panic::resume_unwind(panic);
            }
        }
    }
}

/// The triangles of each material, by rising material, in the order of the mesh.
pub fn by_material(mesh: &Mesh) -> Vec<(u32, Vec<[u32; 3]>)> {
    let mut groups: BTreeMap<u32, Vec<[u32; 3]>> = BTreeMap::new();
    for part in &mesh.parts {
        let range = part.triangles.start as usize..part.triangles.end as usize;
        groups.entry(part.material).or_default().extend_from_slice(&mesh.triangles[range]);
    }
    groups.into_iter().filter(|(_, triangles)| !triangles.is_empty()).collect()
}

/// A material's share of `target` triangles of `total`: rounded up, so at least one.
pub fn share(target: usize, count: usize, total: usize) -> usize {
    let product = target as u128 * count as u128;
    usize::try_from(product.div_ceil(total as u128)).expect("at most `target`").max(1)
}

#[cfg(test)]
mod tests {
    use glam::{Vec2, Vec3, Vec4};

    use super::*;
    use crate::plant::Part;

    const KEEP_ALL: EdgeOptions = EdgeOptions { prune: false, lock_border: false };

    /// Of the distance a vertex moves: the root of the weight 1e-7 in `fillVertexQuadrics`.
    const VERTEX_SHARE: f64 = 3.2e-4;

    /// Squares of side 1 in the plane z = 0, `rows` of `columns`, two triangles each.
    ///
    ///     3--4--5
    ///     | /| /|
    ///     0--1--2
    fn sheet(columns: u32, rows: u32) -> Mesh {
        let mut mesh = Mesh::default();
        for y in 0..=rows {
            for x in 0..=columns {
                mesh.positions.push(Vec3::new(x as f32, y as f32, 0.0));
                mesh.normals.push(Vec3::Z);
                mesh.uvs.push(Vec2::new(x as f32, y as f32));
                mesh.base.push(Vec4::ONE);
            }
        }
        let width = columns + 1;
        for corner in (0..rows).flat_map(|y| (0..columns).map(move |x| y * width + x)) {
            let [a, b, c, d] = [corner, corner + 1, corner + width + 1, corner + width];
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
        mesh.parts = Mesh::parts_from_ids(&vec![0; mesh.triangles.len()]);
        mesh
    }

    fn simplified(mesh: &Mesh, target: usize, max_error: f64, method: Method) -> Simplified {
        let simplifier = Simplifier::new(mesh);
        simplifier
            .simplify(&mesh.triangles, target, max_error, method, &Job::default())
            .expect("not cancelled")
    }

    fn area(mesh: &Mesh, triangles: &[[u32; 3]]) -> f64 {
        Mesh { triangles: triangles.to_vec(), ..mesh.clone() }.area()
    }

    #[test]
    fn a_flat_sheet_becomes_a_square_at_no_cost() {
        let mesh = sheet(4, 4);
        for method in [
            Method::Edges(KEEP_ALL),
            Method::Attributes { options: KEEP_ALL, normal_weight: 1.0, uv_weight: 0.0 },
        ] {
            let found = simplified(&mesh, 2, f64::INFINITY, method);
            assert_eq!(found.triangles.len(), 2, "{method:?}");
            assert_eq!(area(&mesh, &found.triangles), 16.0, "the same square: {method:?}");
            // meshoptimizer counts a vertex's own way a little, too
            assert!(found.error < 4.0 * VERTEX_SHARE, "{} m: {method:?}", found.error);
        }
    }

    #[test]
    fn all_of_it_costs_nothing() {
        let mesh = sheet(2, 1);
        for method in [Method::Edges(KEEP_ALL), Method::Sloppy] {
            for target in [4, 5, usize::MAX] {
                let found = simplified(&mesh, target, 0.0, method);
                assert_eq!(found, Simplified { triangles: mesh.triangles.clone(), error: 0.0 });
            }
            let none = Simplifier::new(&Mesh::default());
            let found = none.simplify(&[], 0, 1.0, method, &Job::default()).expect("nothing");
            assert!(found.triangles.is_empty(), "no triangle: {method:?}");
        }
    }

    #[test]
    fn locked_borders_stay() {
        // 16 border vertices in one piece need 14 triangles, however many lie inside
        let mesh = sheet(4, 4);
        let locked = Method::Edges(EdgeOptions { prune: false, lock_border: true });
        let found = simplified(&mesh, 2, f64::INFINITY, locked);
        assert_eq!(found.triangles.len(), 14, "only the inside can go");
    }

    #[test]
    fn an_error_is_in_metres_whatever_the_size() {
        // a ridge of height 0.5 over one row of the sheet's vertices
        for size in [1e-3_f32, 1.0, 1e3] {
            let mut mesh = sheet(6, 6);
            for position in &mut mesh.positions {
                let height = if position.y == 3.0 { 0.5 } else { 0.0 };
                *position = (*position + Vec3::Z * height) * size;
            }
            let options = EdgeOptions { prune: true, lock_border: false };
            for method in [Method::Edges(options), Method::Sloppy] {
                let rel = simplified(&mesh, 6, f64::INFINITY, method).error / f64::from(size);
                assert!(rel > 0.01 && rel < 2.0, "{rel} of a sheet of 6: {method:?}, {size}");
            }
            let allowed = f64::from(size) * 0.01;
            let found = simplified(&mesh, 2, allowed, Method::Edges(options));
            assert!(found.error <= allowed, "{} of {allowed} m", found.error);
            assert!(found.triangles.len() > 2, "the ridge needs more: {}", found.triangles.len());
        }
    }

    #[test]
    fn a_cancelled_job_is_not_waited_for() {
        let job = Job::default();
        let start = std::time::Instant::now();
        let result = thread::scope(|scope| {
            scope.spawn(|| {
                thread::sleep(Duration::from_millis(50));
                job.cancel();
            });
            waited_for(&job, || thread::sleep(Duration::from_secs(20)))
        });
        assert_eq!(result, Err(LodError::Cancelled), "cancelled");
        assert!(start.elapsed() < Duration::from_secs(10), "without waiting for the sleeper");
        assert_eq!(waited_for(&Job::default(), || 3), Ok(3), "and else its result");
    }

    #[test]
    #[should_panic(expected = "as it is")]
    fn a_panic_is_passed_on() {
        let _ = waited_for(&Job::default(), || panic!("as it is"));
    }

    #[test]
    fn triangles_are_grouped_and_shared_out() {
        let mut mesh = sheet(3, 1);
        mesh.parts = Mesh::parts_from_ids(&[1, 0, 1, 1, 2, 0]);
        mesh.parts.insert(0, Part { material: 7, triangles: 0..0 });
        let t = &mesh.triangles;
        let expected = [(0, vec![t[1], t[5]]), (1, vec![t[0], t[2], t[3]]), (2, vec![t[4]])];
        assert_eq!(by_material(&mesh), expected, "each once, in order, and no empty one");
        let shares: Vec<usize> = [90, 9, 1].iter().map(|&count| share(10, count, 100)).collect();
        assert_eq!(shares, [9, 1, 1], "rounded up");
        assert_eq!(share(usize::MAX, 3, 3), usize::MAX, "too many are no overflow");
        assert_eq!(share(0, 3, 3), 1, "at least one");
    }
}
