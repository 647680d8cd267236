// Leaves that a map places on a shape. The twin of texture/distribution.rs.

struct Distribution {
    // Texels a row, rows, layers.
    size: vec4<u32>,
    leaf_size: vec2<f32>,
    version_size: vec2<f32>,
    largest_tint: vec4<f32>,
    // Upper left corners of the turned leaves, two by two.
    versions: array<vec4<f32>, 64>,
}

@group(3) @binding(0) var leaves: texture_2d<f32>;
@group(3) @binding(1) var leaf_sampler: sampler;
@group(3) @binding(2) var<uniform> distribution: Distribution;
// Corner; rotation and tint.
@group(3) @binding(3) var<storage, read> places: array<vec2<u32>>;

// Alpha from which a layer hides those behind it.
const HIDES: f32 = 0.5;

fn linear(code: u32) -> f32 {
    let encoded = f32(code) / 255.0;
    return select(pow((encoded + 0.055) / 1.055, 2.4), encoded / 12.92, encoded <= 0.04045);
}

fn look(in: Corner) -> Texel {
    let uv = in.uv;
#if TRILINEAR
    let texels = vec2<f32>(textureDimensions(leaves)) * distribution.version_size / distribution.leaf_size;
    let lod = level(dpdxFine(uv) * texels, dpdyFine(uv) * texels);
#else
    let lod = 0.0;
#endif
    let size = distribution.size.xy;
    let cell = vec2<u32>(clamp(uv * vec2<f32>(size), vec2(0.0), vec2<f32>(size) - 1.0));
    var best = vec4(0.0);
    var tint = 0u;
    for (var layer = 0u; layer < distribution.size.z; layer++) {
        let place = places[(layer * size.y + cell.y) * size.x + cell.x];
        if place.x == 0xFFFFFFFFu {
            continue;
        }
        let share = vec2(f32(place.x & 0xFFFFu), f32(place.x >> 16u)) / 65534.0;
        let corner = share * (distribution.leaf_size * 2.0 + 1.0) - distribution.leaf_size;
        var inside = (uv - corner) / distribution.leaf_size;
        if (place.y & 0x80u) != 0u {
            inside.x = 1.0 - inside.x;
        }
        if any(inside < vec2(0.0)) || any(inside > vec2(1.0)) {
            continue;
        }
        let version = place.y & 0x7Fu;
        let pair = distribution.versions[version / 2u];
        let at = select(pair.xy, pair.zw, version % 2u == 1u) + inside * distribution.version_size;
        let texel = textureSampleLevel(leaves, leaf_sampler, at, lod);
        if texel.w > best.w {
            best = texel;
            tint = place.y >> 8u;
        }
        if texel.w >= HIDES {
            break;
        }
    }
    let hue = vec3(linear(tint & 0xFFu), linear((tint >> 8u) & 0xFFu), linear(tint >> 16u));
    let seen = straight(best);
    return Texel(seen.color * hue * distribution.largest_tint.x, seen.alpha);
}
