// Adds the samples of a picture to what others have added before, and ends the picture. The twin of
// `resolve` in raster/tile.rs and of raster/frame.rs.

struct Sum {
    // Pixels a row, rows, samples a pixel; 1 for the first samples of a picture.
    size: vec4<u32>,
    // The near plane's depth, the greatest depth, 1 in perspective, the weight of a sample.
    depth: vec4<f32>,
    background: vec4<f32>,
}

@group(0) @binding(0) var<uniform> sum: Sum;
@group(0) @binding(1) var<storage, read_write> color_sum: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> albedo_sum: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> normal_sum: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> nearest: array<f32>;
@group(0) @binding(5) var<storage, read_write> ids: array<u32>;
@group(0) @binding(6) var<storage, read_write> coded: array<u32>;

#if FINISH
fn encoded(linear: f32) -> u32 {
    let inside = clamp(linear, 0.0, 1.0);
    let curve = 1.055 * pow(inside, 1.0 / 2.4) - 0.055;
    return u32(select(curve, inside * 12.92, inside <= 0.0031308) * 255.0 + 0.5);
}

@compute @workgroup_size(8, 8) fn finish(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= sum.size.x || id.y >= sum.size.y {
        return;
    }
    let at = id.y * sum.size.x + id.x;
#if COLOR
    let color = color_sum[at] + sum.background * (1.0 - color_sum[at].w);
    color_sum[at] = color;
#if COLOR8
    let alpha = u32(clamp(color.w, 0.0, 1.0) * 255.0 + 0.5);
    coded[at] = encoded(color.x) | (encoded(color.y) << 8u) | (encoded(color.z) << 16u) | (alpha << 24u);
#endif
#endif
#if ALBEDO
    albedo_sum[at] += sum.background * (1.0 - albedo_sum[at].w);
#endif
}
#else
#if FOUR_COLORS
@group(0) @binding(7) var color_drawn: texture_multisampled_2d<f32>;
#else
@group(0) @binding(7) var color_drawn: texture_2d<f32>;
#endif
#if FOUR
@group(0) @binding(8) var depth_drawn: texture_depth_multisampled_2d;
#else
@group(0) @binding(8) var depth_drawn: texture_depth_2d;
#endif
@group(0) @binding(9) var albedo_drawn: texture_2d<f32>;
@group(0) @binding(10) var normal_drawn: texture_2d<f32>;
@group(0) @binding(11) var id_drawn: texture_2d<u32>;

@compute @workgroup_size(8, 8) fn add(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= sum.size.x || id.y >= sum.size.y {
        return;
    }
    let at = id.y * sum.size.x + id.x;
    let pixel = vec2<i32>(id.xy);
    let is_first = sum.size.w == 1u;
#if COLOR
#if FOUR_COLORS
    var color = vec4(0.0);
    for (var s = 0; s < i32(sum.size.z); s++) {
        color += textureLoad(color_drawn, pixel, s);
    }
#else
    // of four samples that the card has resolved it is their mean
    let color = textureLoad(color_drawn, pixel, 0) * f32(sum.size.z);
#endif
    color_sum[at] = select(color_sum[at], vec4(0.0), is_first) + color * sum.depth.w;
#endif
#if ALBEDO
    let albedo = textureLoad(albedo_drawn, pixel, 0) * sum.depth.w;
    albedo_sum[at] = select(albedo_sum[at], vec4(0.0), is_first) + albedo;
#endif
#if NORMAL
    let normal = textureLoad(normal_drawn, pixel, 0) * sum.depth.w;
    normal_sum[at] = select(normal_sum[at], vec4(0.0), is_first) + normal;
#endif
#if DEPTH
    var z = 0.0;
    for (var s = 0; s < i32(sum.size.z); s++) {
        z = max(z, textureLoad(depth_drawn, pixel, s));
    }
    let infinite = bitcast<f32>(0x7F800000u + sum.size.w * 0u);
    let near = sum.depth.x;
    let far = sum.depth.y;
    let there = select(far - z * (far - near), near / z, sum.depth.z == 1.0);
    let depth = select(infinite, there, z > 0.0);
    let before = select(nearest[at], infinite, is_first);
    let is_nearer = depth < before;
    nearest[at] = select(before, depth, is_nearer);
#if IDS
    let id_here = textureLoad(id_drawn, pixel, 0).x;
    let id_before = select(ids[at], 0xFFFFFFFFu, is_first);
    ids[at] = select(id_before, id_here, is_nearer);
#endif
#endif
}
#endif
