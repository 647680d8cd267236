//! A picture to compute with: premultiplied linear texels, and how it is halved.

use glam::Vec4;

use crate::texture::texture::{Image, decode};

/// Premultiplied linear texels.
#[derive(Debug, Clone, PartialEq)]
pub struct LinearImage {
    /// Texels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` texels.
    pub texels: Vec<Vec4>,
}

impl LinearImage {
    /// A stored level, decoded.
    pub fn decoded(image: &Image) -> Self {
        let texels = image.texels.iter().map(|&texel| decode(texel)).collect();
        Self { width: image.width, height: image.height, texels }
    }

    /// The texel at a column and row inside the image.
    pub fn texel(&self, x: u32, y: u32) -> Vec4 {
        self.texels[y as usize * self.width as usize + x as usize]
    }

    /// Area mean at half the size, rounded down. Odd sides weigh each texel by its share.
    pub fn halved(&self) -> Self {
        let width = (self.width / 2).max(1);
        let height = (self.height / 2).max(1);
        let mut texels = Vec::with_capacity(width as usize * height as usize);
        if self.width == 2 * width && self.height == 2 * height {
            // as below, where every share is a half
            for rows in self.texels.chunks_exact(2 * self.width as usize) {
                let (upper, lower) = rows.split_at(self.width as usize);
                let pairs = upper.as_chunks::<2>().0.iter().zip(lower.as_chunks::<2>().0);
                texels.extend(pairs.map(|([a, b], [c, d])| {
                    Vec4::ZERO + *a * 0.25 + *b * 0.25 + *c * 0.25 + *d * 0.25
                }));
            }
            return Self { width, height, texels };
        }
        let columns: Vec<_> = (0..width).map(|x| shares(x, width, self.width)).collect();
        for y in 0..height {
            let rows = shares(y, height, self.height);
            for column in &columns {
                let mut sum = Vec4::ZERO;
                for &(row, row_share) in &rows {
                    for &(x, share) in column {
                        sum += self.texel(x, row) * (share * row_share);
                    }
                }
                texels.push(sum);
            }
        }
        Self { width, height, texels }
    }
}

/// Which of `from` source texels texel `index` of `to` covers, and the share of each.
fn shares(index: u32, to: u32, from: u32) -> Vec<(u32, f32)> {
    // in units where a source texel is `to` long and a target texel `from`
    let (start, end) = (u64::from(index) * u64::from(from), u64::from(index + 1) * u64::from(from));
    let unit = u64::from(to);
    let first = start / unit;
    let last = (end - 1) / unit;
    (first..=last)
        .map(|texel| {
            let overlap = end.min((texel + 1) * unit) - start.max(texel * unit);
            let index = u32::try_from(texel).expect("inside the source");
            (index, overlap as f32 / from as f32)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn odd_sides_weigh_each_texel_by_its_share() {
        // five on two: the middle one is shared
        let texels = [255, 255, 255, 0, 0].map(|alpha| [255, 255, 255, alpha]).to_vec();
        let row = Image::new(5, 1, texels).expect("valid");
        let image = LinearImage::decoded(&row);
        let half = image.halved();
        assert_eq!((half.width, half.height), (2, 1), "5 halves to 2");
        let error = (half.texels[0].w - 1.0).abs().max((half.texels[1].w - 0.2).abs());
        assert!(error < 1e-6, "{:?}", half.texels);
    }
}
