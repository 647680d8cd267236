// From the corners of shapes to what shows in a sample. The twin of raster/shade.rs and raster/tile.rs;
// each surface adds its own function.

#if ANY_TARGET
struct Targets {
#if COLOR
    @location(0) color: vec4<f32>,
#endif
#if ALBEDO
    @location(1) albedo: vec4<f32>,
#endif
#if NORMAL
    @location(2) normal: vec4<f32>,
#endif
#if ID_TARGET
    @location(3) id: u32,
#endif
#if PRODUCT
    @location(0) alpha: f32,
#endif
#if PARALLAX
    @builtin(frag_depth) depth: f32,
#endif
}
#endif

// What a surface shows at a point.
struct Texel {
    // Linear, not premultiplied; 0 where nothing is there.
    color: vec3<f32>,
    alpha: f32,
}

fn straight(texel: vec4<f32>) -> Texel {
    if texel.w == 0.0 {
        return Texel(vec3(0.0), 0.0);
    }
    return Texel(texel.xyz * (1.0 / texel.w), texel.w);
}

// Level of detail from the steps over a pixel, in texels.
fn level(right: vec2<f32>, down: vec2<f32>) -> f32 {
    return 0.5 * log2(max(max(dot(right, right), dot(down, down)), 1e-38));
}

#if DITHER
// Whether a fade keeps a sample: raster/visible.rs.
fn is_kept(pixel: vec2<u32>, number: u32, seed: u32, fade: f32) -> bool {
    var hash = seed * 0x9E3779B9u;
    hash = (hash ^ pixel.x) * 0x85EBCA6Bu;
    hash ^= hash >> 15u;
    hash = (hash ^ pixel.y) * 0x85EBCA6Bu;
    hash ^= hash >> 15u;
    hash = (hash ^ number) * 0x85EBCA6Bu;
    hash ^= hash >> 15u;
    hash *= 0xC2B2AE35u;
    let random = f32((hash ^ (hash >> 16u)) >> 8u) * (1.0 / 16777216.0);
    if fade >= 0.0 {
        return random < fade;
    }
    return random >= 1.0 + fade;
}
#endif

#if COVERAGE
// Alpha from which a shape is there in a sample: raster/samples.rs.
fn threshold(number: u32, set_size: u32, seed: u32, id: u32) -> f32 {
    var hash = ((seed ^ 0x9E3779B9u) * 0x85EBCA6Bu) ^ id;
    hash = (hash ^ (hash >> 16u)) * 0x7FEB352Du;
    hash = (hash ^ (hash >> 15u)) * 0x846CA68Bu;
    hash ^= hash >> 16u;
    let rank = ((number ^ (hash >> 8u)) * (hash | 1u)) & (set_size - 1u);
    // a little less: alpha that was rounded to a half must pass where it equals it
    return (f32(rank) + 0.5) / f32(set_size) * (1.0 - 1.0 / 2048.0);
}
#endif

#if DEPTH
fn depth_of(z: f32) -> f32 {
    let near = view.away.w;
    if view.scale.w == 1.0 {
        return near / z;
    }
    return view.scale.z - z * (view.scale.z - near);
}
#endif

#if ORDER
// Paint orders up to which opacity from the front reaches a half, as far as they are known.
@group(0) @binding(4) var<storage, read> found: array<u32>;
#endif

@fragment fn shade(
    corner: Corner,
    @builtin(front_facing) faces: bool,
#if SAMPLED
    @builtin(sample_index) in_pixel: u32,
#endif
)
#if ANY_TARGET
    -> Targets
#endif
{
    let in = corrected(corner);
#if PARALLAX
    let tint = instances[in.what.y].tint;
    let seen = look(in);
    let alpha = seen.alpha * tint.w;
    let z = seen.z;
    let is_missed = seen.alpha <= 0.0 || z <= 0.0 || z > 1.0;
#else
#if SURFACE
    let texel = look(in);
#else
    let texel = Texel(vec3(1.0), 1.0);
#endif
#if ALPHA
    let alpha = in.opacity * texel.alpha;
#endif
    let z = in.place.z;
#endif
    let pixel = vec2<u32>(in.place.xy);
#if PARALLAX
    if is_missed {
        discard;
    }
#endif
#if SLAB
    let depth = depth_of(z);
    let slab = items[in.what.x].slab;
    if depth < slab.x || depth >= slab.y {
        discard;
    }
#endif
#if SAMPLED
    let number = view.sample.x + in_pixel;
#endif
#if DITHER
    if !is_kept(pixel, number, instances[in.what.y].seed, instances[in.what.y].fade) {
        discard;
    }
#endif
#if TEST
    if alpha < items[in.what.x].cutoff {
        discard;
    }
#endif
#if COVERAGE
    if alpha < threshold(number, view.sample.y, instances[in.what.y].seed, in.what.z) {
        discard;
    }
#endif
#if ORDER
    let known = found[pixel.y * view.size.x + pixel.x];
#if PRODUCT
    if in.order < known + view.sample.z {
        discard;
    }
#else
    // orders count from 1, and where nothing was found it is 0
    if in.order != known {
        discard;
    }
#endif
#endif
#if OVER
    let shown = clamp(alpha, 0.0, 1.0);
#if HIDES
    if shown <= 0.0 {
        discard;
    }
#endif
#else
    let shown = 1.0;
#endif
#if ANY_TARGET
    var targets: Targets;
#if PRODUCT
    targets.alpha = shown;
#endif
#if ID_TARGET
    targets.id = in.what.z;
#endif
#if PARALLAX
    targets.depth = z;
#if COLOR
    targets.color = vec4(seen.color * tint.xyz * shown, shown);
#endif
#if ALBEDO
    targets.albedo = vec4(seen.albedo * tint.xyz * shown, shown);
#endif
#if NORMAL
    targets.normal = vec4(unit(turned(in.what.y, seen.normal)) * shown, shown);
#endif
#else
#if FACING
    // corners as stored run counter-clockwise on the front, which a mirrored copy turns round
    let is_front = select(in.side == 1u, faces != (in.side == 3u), in.side >= 2u);
#endif
#if COLOR
    let lit = select(in.back, in.front, is_front);
    targets.color = vec4(lit * texel.color * shown, shown);
#endif
#if ALBEDO
    targets.albedo = vec4(in.base * texel.color * shown, shown);
#endif
#if NORMAL
    let normal = unit(turned(in.what.y, in.normal)) * select(-1.0, 1.0, is_front);
    targets.normal = vec4(normal * shown, shown);
#endif
#endif
    return targets;
#endif
}

// What was interpolated, without what drivers do to it.
fn corrected(corner: Corner) -> Corner {
    var in = corner;
#if FOUR
#if ALPHA
    in.opacity /= in.one;
#endif
#if UV
    in.uv /= in.one;
#endif
#if LIT
    in.front /= in.one;
    in.back /= in.one;
#endif
#if LOCAL
    in.local /= in.one;
#endif
#endif
    return in;
}

#if NORMAL
fn unit(vector: vec3<f32>) -> vec3<f32> {
    let length = length(vector);
    return select(vec3(0.0), vector / length, length > 0.0);
}
#endif
