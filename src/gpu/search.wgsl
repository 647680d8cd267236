// Searches the blended shape at which opacity, gathered front to back, reaches a half: the last one in
// paint order from which on the shapes let at most half through. One bit of its number a step.

struct Search {
    // Pixels a row, rows; the step.
    size: vec4<u32>,
}

@group(0) @binding(0) var<uniform> search: Search;
// What the shapes from `found + step` on let through.
@group(0) @binding(1) var through: texture_2d<f32>;
@group(0) @binding(2) var<storage, read_write> found: array<u32>;

@compute @workgroup_size(8, 8) fn step(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= search.size.x || id.y >= search.size.y {
        return;
    }
    let at = id.y * search.size.x + id.x;
    if 1.0 - textureLoad(through, vec2<i32>(id.xy), 0).x >= 0.5 {
        found[at] += search.size.z;
    }
}
