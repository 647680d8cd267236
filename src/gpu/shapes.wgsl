// From the arrays of a draw list to the corners of shapes on the picture. The twin of raster/placing.rs
// and raster/setup.rs.

struct View {
    // Axes times pixels a metre at depth 1 (perspective) or at any depth; w: by how many pixels the
    // picture is shifted, so that a sample lies in the middle of its pixel.
    right: vec4<f32>,
    down: vec4<f32>,
    // Along the view; w: the near plane's depth.
    away: vec4<f32>,
    // 2 / width, 2 / height, the greatest depth of a parallel view, and 1 for a perspective one.
    scale: vec4<f32>,
    // Number of the sample in its set, size of the set, step of the search.
    sample: vec4<u32>,
    // Pixels a row, rows.
    size: vec4<u32>,
}

struct Instance {
    // Columns of the map to axes relative to the eye; w: its offset.
    x: vec4<f32>,
    y: vec4<f32>,
    z: vec4<f32>,
    // That offset as it lies on the picture.
    offset: vec4<f32>,
    tint: vec4<f32>,
    params: array<vec4<f32>, 2>,
    fade: f32,
    seed: u32,
    // 1 where the map mirrors.
    mirrored: u32,
    // 1, which no compiler knows.
    one: f32,
}

struct Item {
    // Depths, from the first to before the second.
    slab: vec2<f32>,
    cutoff: f32,
    // Pixels across a line, or a side of a point.
    size: f32,
    has_ids: u32,
    step_count: u32,
    tolerance: f32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
// One a copy of an item: the item, the instance, the paint order of its primitive 0.
@group(0) @binding(2) var<storage, read> draws: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> items: array<Item>;

@group(1) @binding(0) var<storage, read> positions: array<f32>;
@group(1) @binding(1) var<storage, read> normals: array<f32>;
@group(1) @binding(2) var<storage, read> uvs: array<vec2<f32>>;
@group(1) @binding(3) var<storage, read> base: array<vec4<f32>>;
@group(1) @binding(4) var<storage, read> front: array<f32>;
@group(1) @binding(5) var<storage, read> back: array<f32>;

@group(2) @binding(0) var<storage, read> indices: array<u32>;
@group(2) @binding(1) var<storage, read> source_ids: array<u32>;

struct Corner {
    @invariant @builtin(position) place: vec4<f32>,
#if WHAT
    // Item, instance, id.
    @location(0) @interpolate(flat) what: vec3<u32>,
#endif
#if FACING
    // The side that is seen: 0 back, 1 front, 2 the one that faces, 3 the other.
    @location(10) @interpolate(flat) side: u32,
#endif
#if ORDER
    @location(1) @interpolate(flat) order: u32,
#endif
#if ALPHA
    @location(2) @interpolate(perspective, RATE) opacity: f32,
#endif
#if UV
    @location(3) @interpolate(perspective, RATE) uv: vec2<f32>,
#endif
#if LIT
    @location(4) @interpolate(perspective, RATE) front: vec3<f32>,
    @location(5) @interpolate(perspective, RATE) back: vec3<f32>,
#endif
#if BASE
    @location(6) @interpolate(perspective, RATE) base: vec3<f32>,
#endif
#if NORMAL
    @location(7) @interpolate(perspective, RATE) normal: vec3<f32>,
#endif
#if LOCAL
    @location(8) @interpolate(perspective, RATE) local: vec3<f32>,
#endif
#if FOUR
    // 1 everywhere. Some drivers (Mesa's llvmpipe 22.3) divide what they interpolate away from a pixel's
    // middle by the depth in the middle. What comes out where 1 went in is how far they are off.
    @location(9) @interpolate(perspective, RATE) one: f32,
#endif
}

// What lies behind the near plane as a whole, or nowhere.
const NOWHERE: vec4<f32> = vec4(2.0, 2.0, 2.0, 1.0);

fn position(at: u32) -> vec3<f32> {
    return vec3(positions[3u * at], positions[3u * at + 1u], positions[3u * at + 2u]);
}

fn normal_at(at: u32) -> vec3<f32> {
    return vec3(normals[3u * at], normals[3u * at + 1u], normals[3u * at + 2u]);
}

// Pixels from the picture's middle (times depth in perspective), and depth.
fn on_picture(instance: u32, local: vec3<f32>) -> vec3<f32> {
    let at = turned_to_eye(instance, local);
    let from_origin = vec3(dot(view.right.xyz, at), dot(view.down.xyz, at), dot(view.away.xyz, at));
    return from_origin + instances[instance].offset.xyz;
}

// Along the world's axes, from where the copy's origin stands.
fn turned_to_eye(instance: u32, local: vec3<f32>) -> vec3<f32> {
    let x = instances[instance].x.xyz;
    let y = instances[instance].y.xyz;
    let z = instances[instance].z.xyz;
    return x * local.x + y * local.y + z * local.z;
}

fn from_eye(instance: u32, local: vec3<f32>) -> vec3<f32> {
    let offset = vec3(instances[instance].x.w, instances[instance].y.w, instances[instance].z.w);
    return turned_to_eye(instance, local) + offset;
}

// How normals turn: the cofactors of the linear map. Their lengths change.
fn turned(instance: u32, normal: vec3<f32>) -> vec3<f32> {
    let x = instances[instance].x.xyz;
    let y = instances[instance].y.xyz;
    let z = instances[instance].z.xyz;
    let sign = select(1.0, -1.0, instances[instance].mirrored == 1u);
    return (cross(y, z) * normal.x + cross(z, x) * normal.y + cross(x, y) * normal.z) * sign;
}

// Clip coordinates of a point of the picture. Depth is near / depth, or falls from 1 at the near plane to
// 0 at the greatest depth where lines are parallel.
fn clip(at: vec3<f32>) -> vec4<f32> {
    let near = view.away.w;
    let shift = vec2(view.right.w, view.down.w);
    let flip = vec2(view.scale.x, -view.scale.y);
    if view.scale.w == 1.0 {
        return vec4((at.xy + shift * at.z) * flip, near, at.z);
    }
    let far = view.scale.z;
    return vec4((at.xy + shift) * flip, (far - at.z) / (far - near), 1.0);
}

#if POINTS_OR_LINES
// 1 if a normal leans towards the eye or is zero.
fn side_seen(instance: u32, local: vec3<f32>, normal: vec3<f32>) -> u32 {
    var to_eye = -view.away.xyz;
    if view.scale.w == 1.0 {
        to_eye = -from_eye(instance, local);
    }
    return select(1u, 0u, dot(turned(instance, normal), to_eye) < 0.0);
}

// Pixels from the middle, without the depth in them.
fn pixels(at: vec3<f32>) -> vec2<f32> {
    return at.xy / select(1.0, at.z, view.scale.w == 1.0);
}

// As clip, from pixels.
fn clip_pixels(at: vec2<f32>, depth: f32) -> vec4<f32> {
    let times = select(1.0, depth, view.scale.w == 1.0);
    return clip(vec3(at * times, depth));
}
#endif

#if POINTS
fn point_corner(corner: u32, instance: u32, local: vec3<f32>, size: f32) -> vec4<f32> {
    let at = on_picture(instance, local);
    if at.z < view.away.w {
        return NOWHERE;
    }
    let side = vec2(select(-0.5, 0.5, corner == 1u || corner == 2u), select(-0.5, 0.5, corner >= 2u));
    let depth = clip(at);
    // all four corners at one depth, whatever the perspective
    let spot = pixels(at) + side * size + vec2(view.right.w, view.down.w);
    return vec4(spot * vec2(view.scale.x, -view.scale.y), depth.z / depth.w, 1.0);
}
#endif

#if LINES
fn line_corner(corner: u32, instance: u32, vertices: vec2<u32>, width: f32) -> vec4<f32> {
    let near = view.away.w;
    var a = on_picture(instance, position(vertices.x));
    var b = on_picture(instance, position(vertices.y));
    if a.z < near && b.z < near {
        return NOWHERE;
    }
    if a.z < near {
        a += (b - a) * ((near - a.z) / (b.z - a.z));
        a.z = near;
    } else if b.z < near {
        b += (a - b) * ((near - b.z) / (a.z - b.z));
        b.z = near;
    }
    let from_a = pixels(a);
    let from_b = pixels(b);
    let along = from_b - from_a;
    let length = length(along);
    if length == 0.0 {
        return NOWHERE;
    }
    let across = vec2(-along.y, along.x) * (width * 0.5 / length);
    let sign = select(-1.0, 1.0, corner >= 2u);
    if corner == 0u || corner == 3u {
        return clip_pixels(from_a + across * sign, a.z);
    }
    return clip_pixels(from_b + across * sign, b.z);
}
#endif

// What is known of a vertex: shapes that share corners by their indices get it from the card.
struct Vertex {
    @location(0) position: vec3<f32>,
#if NORMAL
    @location(1) normal: vec3<f32>,
#endif
#if UV
    @location(2) uv: vec2<f32>,
#endif
#if BASE_OR_ALPHA
    @location(3) base: vec4<f32>,
#endif
#if LIT
    @location(4) front: vec3<f32>,
    @location(5) back: vec3<f32>,
#endif
}

fn vertex_at(at: u32) -> Vertex {
    var vertex: Vertex;
    vertex.position = position(at);
#if NORMAL
    vertex.normal = normal_at(at);
#endif
#if UV
    vertex.uv = uvs[at];
#endif
#if BASE_OR_ALPHA
    vertex.base = base[at];
#endif
#if LIT
    vertex.front = vec3(front[3u * at], front[3u * at + 1u], front[3u * at + 2u]);
    vertex.back = vec3(back[3u * at], back[3u * at + 1u], back[3u * at + 2u]);
#endif
    return vertex;
}

@vertex fn place(
#if INDEXED
    vertex: Vertex,
#else
    @builtin(vertex_index) number: u32,
#endif
    @builtin(instance_index) draw: u32,
) -> Corner {
    let drawn = draws[draw];
    let instance = drawn.y;
    var side = select(2u, 3u, instances[instance].mirrored == 1u);
#if INDEXED
    let primitive = 0u;
#else
    let primitive = number / CORNERS;
    let corner = number % CORNERS;
#if POINTS
    let at = indices[primitive];
#elif LINES
    let ends = vec2(indices[2u * primitive], indices[2u * primitive + 1u]);
    let at = select(ends.y, ends.x, corner == 0u || corner == 3u);
#else
    let at = indices[number];
#endif
    let vertex = vertex_at(at);
#endif
    var made: Corner;
#if POINTS
    made.place = point_corner(corner, instance, vertex.position, items[drawn.x].size);
    side = side_seen(instance, vertex.position, normal_at(at));
#elif LINES
    made.place = line_corner(corner, instance, ends, items[drawn.x].size);
    side = side_seen(instance, position(ends.x), normal_at(ends.x));
#else
    made.place = clip(on_picture(instance, vertex.position));
#endif
    var id = primitive;
#if IDS
    if items[drawn.x].has_ids == 1u {
        id = source_ids[primitive];
    }
#endif
#if WHAT
    made.what = vec3(drawn.x, instance, id);
#endif
#if FACING
    made.side = side;
#endif
#if TINTED
    let tint = instances[instance].tint;
#endif
#if ORDER
    made.order = drawn.z + primitive;
#endif
#if ALPHA
    made.opacity = vertex.base.w * tint.w;
#endif
#if UV
    made.uv = vertex.uv;
#endif
#if LIT
    made.front = vertex.front * tint.xyz;
    made.back = vertex.back * tint.xyz;
#endif
#if BASE
    made.base = vertex.base.xyz * tint.xyz;
#endif
#if NORMAL
    made.normal = vertex.normal;
#endif
#if LOCAL
    made.local = vertex.position;
#endif
#if FOUR
    made.one = instances[instance].one;
#endif
    return made;
}
