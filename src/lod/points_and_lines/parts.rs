//! Which parts of a plant become points or lines, and how important they are.
//!
//! A part is what wood or leaves have of one material. By itself it becomes lines if most of its area
//! belongs to pieces at least four times as long as wide, else points; pieces of a part of lines that
//! are shorter become points all the same. Its importance follows from how much its mean colour differs
//! from the plant's.

use glam::DVec3;

use crate::error::{LodError, check_in};
use crate::job::{ELEMENTS_PER_CHECK, Job};
use crate::lod::points_and_lines::color_distance::importance;
use crate::lod::points_and_lines::opaque::Cover;
use crate::lod::points_and_lines::pieces::{Form, Piece};
use crate::plant::mesh::triangle_area;
use crate::plant::{Material, Mesh};

/// Length over width from which a piece may be a line.
pub const MIN_ELONGATION: f64 = 4.0;

/// Share of a part's area that such pieces must have.
const MIN_LONG_SHARE: f64 = 0.5;

/// Largest importance that can be given.
pub const MAX_IMPORTANCE: f64 = 64.0;

/// What pieces are drawn as when they are small on the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Class {
    /// Triangles, always.
    Mesh,
    /// Points.
    Points,
    /// Lines.
    Lines,
}

/// What wood or leaves have of one material.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// `wood:` or `foliage:` and the material's name.
    pub name: String,
    /// Whether it belongs to the wood.
    pub is_wood: bool,
    /// Index into the plant's materials.
    pub material: u32,
    /// What it is drawn as.
    pub class: Class,
    /// Whether the class was given, and so holds for each of its pieces.
    pub is_given: bool,
    /// Divides the distance between samples; at least 1.
    pub importance: f64,
    /// Mean linear lit colour where it is opaque, over both sides.
    pub color: DVec3,
    /// Opaque area in square metres.
    pub area: f64,
    /// Leaves, or pieces of wood.
    pub piece_count: u32,
}

impl Part {
    /// What one of its pieces is drawn as.
    pub fn class_of(&self, form: &Form) -> Class {
        if self.class == Class::Lines && !self.is_given && form.elongation < MIN_ELONGATION {
            return Class::Points;
        }
        self.class
    }
}

/// What the user says about parts, by name: that of a part, of a material, `wood`, `foliage`, or `*` for
/// all. Later entries overrule earlier ones.
#[derive(Debug, Clone, Default)]
pub struct Wishes {
    /// Class; `None` is the automatic one.
    pub classes: Vec<(String, Option<Class>)>,
    /// Importance of those that are named.
    pub importance: Vec<(String, f64)>,
    /// Whether the importance of all others follows from their colour; else it is 1.
    pub automatic_importance: bool,
}

/// The parts of a plant, wood first, by material, and the part of each piece.
///
/// # Errors
/// A name that is none of a part's; an importance out of range; [`LodError::Cancelled`].
pub fn parts(
    mesh: &Mesh,
    materials: &[Material],
    pieces: &[Piece],
    forms: &[Form],
    wishes: &Wishes,
    job: &Job,
) -> Result<(Vec<Part>, Vec<u32>), LodError> {
    let mut keys: Vec<(bool, u32)> = pieces.iter().map(|p| (!p.is_wood, p.material)).collect();
    keys.sort_unstable();
    keys.dedup();
    let covers: Vec<Cover<'_>> = materials.iter().map(Cover::new).collect();
    let mut parts: Vec<Part> = keys
        .iter()
        .map(|&(is_leaf, material)| {
            let kind = if is_leaf { "foliage" } else { "wood" };
            Part {
                name: format!("{kind}:{}", materials[material as usize].name),
                is_wood: !is_leaf,
                material,
                class: Class::Points,
                is_given: false,
                importance: 1.0,
                color: DVec3::ZERO,
                area: 0.0,
                piece_count: 0,
            }
        })
        .collect();
    let mut long_areas = vec![(0.0, 0.0); parts.len()];
    let mut part_of = Vec::with_capacity(pieces.len());
    let mut looked_at = 0;
    for (piece, form) in pieces.iter().zip(forms) {
        let key = (!piece.is_wood, piece.material);
        let number = keys.binary_search(&key).expect("every piece's key is there");
        part_of.push(u32::try_from(number).expect("few parts"));
        let part = &mut parts[number];
        part.piece_count += 1;
        long_areas[number].1 += form.area;
        if form.elongation >= MIN_ELONGATION {
            long_areas[number].0 += form.area;
        }
        for &triangle in &piece.triangles {
            looked_at += 1;
            if looked_at % (ELEMENTS_PER_CHECK / 16) == 0 {
                job.check()?;
            }
            let (texel, share) = covers[piece.material as usize].mean(mesh, triangle as usize);
            let area = triangle_area(mesh.corners(triangle as usize)) * f64::from(share);
            let corners = mesh.triangles[triangle as usize].map(|v| v as usize);
            let lit: glam::Vec3 = corners.iter().map(|&v| mesh.front[v] + mesh.back[v]).sum();
            part.color += (lit * texel).as_dvec3() * (area / 6.0);
            part.area += area;
        }
    }
    let sum: DVec3 = parts.iter().map(|part| part.color).sum();
    let area: f64 = parts.iter().map(|part| part.area).sum();
    let plant_color = if area > 0.0 { sum / area } else { DVec3::ZERO };
    for (part, (long, all)) in parts.iter_mut().zip(long_areas) {
        if part.area > 0.0 {
            part.color /= part.area;
            if wishes.automatic_importance {
                part.importance = importance(part.color, plant_color);
            }
        }
        let is_long = all > 0.0 && long >= MIN_LONG_SHARE * all;
        part.class = if is_long { Class::Lines } else { Class::Points };
    }
    for (name, class) in &wishes.classes {
        for part in named(&mut parts, "classes", name, materials)? {
            if let Some(class) = class {
                (part.class, part.is_given) = (*class, true);
            }
        }
    }
    for (name, importance) in &wishes.importance {
        check_in("importance", *importance, 1.0..=MAX_IMPORTANCE)?;
        for part in named(&mut parts, "importance", name, materials)? {
            part.importance = *importance;
        }
    }
    Ok((parts, part_of))
}

fn named<'a>(
    parts: &'a mut [Part],
    argument: &'static str,
    name: &str,
    materials: &[Material],
) -> Result<Vec<&'a mut Part>, LodError> {
    let fits = |part: &Part| {
        let kind = if part.is_wood { "wood" } else { "foliage" };
        ["*", kind, &part.name, &materials[part.material as usize].name].contains(&name)
    };
    if !parts.iter().any(fits) {
        let known: Vec<&str> = parts.iter().map(|part| &part.name[..]).collect();
        let why = format!("no part is called {name:?}; there are {known:?}");
        return Err(LodError::Invalid { name: argument, why });
    }
    Ok(parts.iter_mut().filter(|part| fits(part)).collect())
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::lod::made::quads;
    use crate::lod::points_and_lines::pieces::{forms, pieces};
    use crate::plant::AlphaMode;
    use crate::texture::Sampler;

    fn material(name: &str) -> Material {
        Material {
            name: name.to_owned(),
            texture: None,
            sampler: Sampler::default(),
            alpha_mode: AlphaMode::Opaque,
            double_sided: true,
        }
    }

    fn found(wishes: &Wishes) -> Result<(Vec<Part>, Vec<Class>), LodError> {
        // wood: a long piece; leaves: two blades and a square of the leaf's colour, a red petal
        let blade = |x: f32| (Vec3::X * x, Vec3::X * 0.1, Vec3::Y);
        let square = (Vec3::Z, Vec3::X * 0.2, Vec3::Y * 0.2);
        let petal = (Vec3::Z * 2.0, Vec3::X * 0.2, Vec3::Y * 0.2);
        let mut mesh = quads(&[blade(9.0), blade(0.0), blade(1.0), square, petal]);
        mesh.front = vec![Vec3::new(0.05, 0.2, 0.03); 20];
        mesh.front[16..].fill(Vec3::new(0.6, 0.0, 0.0));
        mesh.back = mesh.front.clone();
        let materials = [0, 0, 1, 1, 1, 1, 1, 1, 2, 2];
        let names = [material("bark"), material("leaf"), material("petal")];
        let job = Job::default();
        let pieces = pieces(&mesh, &materials, 2, &[0, 2, 4, 6, 8], None, &job)?;
        let forms = forms(&mesh, &pieces, &job)?;
        let (parts, part_of) = parts(&mesh, &names, &pieces, &forms, wishes, &job)?;
        let class = |(form, &part): (&Form, &u32)| parts[part as usize].class_of(form);
        let classes = forms.iter().zip(&part_of).map(class).collect();
        Ok((parts, classes))
    }

    #[test]
    fn classes_and_importance_are_found() {
        use Class::{Lines, Mesh, Points};
        let automatic = Wishes { automatic_importance: true, ..Wishes::default() };
        let (parts, classes) = found(&automatic).expect("valid");
        let names: Vec<&str> = parts.iter().map(|part| &part.name[..]).collect();
        assert_eq!(names, ["wood:bark", "foliage:leaf", "foliage:petal"], "wood first");
        assert_eq!(classes, [Lines, Lines, Lines, Points, Points], "short ones are points");
        let weights: Vec<f64> = parts.iter().map(|part| part.importance).collect();
        let near = weights[..2].iter().all(|&weight| weight < 1.25);
        assert!(near && weights[2] == 4.0, "red among green: {weights:?}");
        assert_eq!(parts[1].piece_count, 3, "two blades and a square");
        assert!((parts[1].area - 0.96).abs() < 1e-6, "2 * 0.4 + 0.16: {}", parts[1].area);

        let wishes = Wishes {
            classes: [("foliage", Some(Mesh)), ("leaf", Some(Lines)), ("wood:bark", None)]
                .map(|(name, class)| (name.to_owned(), class))
                .to_vec(),
            importance: vec![("foliage".to_owned(), 2.0)],
            automatic_importance: false,
        };
        let (parts, classes) = found(&wishes).expect("valid");
        assert_eq!(classes, [Lines, Lines, Lines, Lines, Mesh], "later names overrule");
        let weights: Vec<f64> = parts.iter().map(|part| part.importance).collect();
        assert_eq!(weights, [1.0, 2.0, 2.0], "as given, else 1");
    }

    #[test]
    fn unknown_names_and_weights_out_of_range_are_refused() {
        let unknown = Wishes { classes: vec![("stem".to_owned(), None)], ..Wishes::default() };
        let text = found(&unknown).expect_err("no such part").to_string();
        assert!(text.starts_with("classes: no part is called \"stem\""), "{text}");
        for weight in [0.5, f64::NAN, 65.0] {
            let importance = vec![("leaf".to_owned(), weight)];
            let text = found(&Wishes { importance, ..Wishes::default() }).expect_err("refused");
            assert!(text.to_string().starts_with("importance must be"), "{text}");
        }
    }
}
