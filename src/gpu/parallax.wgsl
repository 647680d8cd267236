// Pictures with depth behind a shape. The twin of texture/frames.rs and raster/parallax.rs.

struct Light {
    // w: share of the light that goes through a leaf.
    sun_direction: vec4<f32>,
    sun: vec4<f32>,
    sky: vec4<f32>,
    ground: vec4<f32>,
}

struct Frames {
    // w: half a frame's side in metres.
    center: vec4<f32>,
    low: vec4<f32>,
    high: vec4<f32>,
    // A frame's sides in the atlas, texels of a side, and how many levels there are.
    size: vec4<f32>,
    light: Light,
}

struct Frame {
    // w: 1 where it was baked.
    toward: vec4<f32>,
    right: vec4<f32>,
    up: vec4<f32>,
    // Upper left corner in the atlas.
    corner: vec4<f32>,
}

@group(3) @binding(0) var colors: texture_2d<f32>;
@group(3) @binding(1) var color_sampler: sampler;
@group(3) @binding(2) var<uniform> frames: Frames;
@group(3) @binding(3) var<storage, read> frame: array<Frame>;
@group(3) @binding(4) var depths: texture_2d<u32>;
@group(3) @binding(5) var normal_map: texture_2d<f32>;
@group(3) @binding(6) var normal_sampler: sampler;

// A frame whose normal a ray meets at a smaller cosine is not seen.
const LEAST_COSINE: f32 = 0.02;

struct Ray {
    point: vec3<f32>,
    direction: vec3<f32>,
    start: f32,
}

struct Hit {
    uv: vec2<f32>,
    along: f32,
    trust: f32,
    there: bool,
}

struct Seen {
    color: vec3<f32>,
    albedo: vec3<f32>,
    normal: vec3<f32>,
    alpha: f32,
    z: f32,
}

// Rows of the inverse of the copy's linear map, times a vector.
fn to_local(instance: u32, vector: vec3<f32>) -> vec3<f32> {
    let x = instances[instance].x.xyz;
    let y = instances[instance].y.xyz;
    let z = instances[instance].z.xyz;
    let volume = dot(x, cross(y, z));
    return vec3(dot(cross(y, z), vector), dot(cross(z, x), vector), dot(cross(x, y), vector)) / volume;
}

fn ray_through(instance: u32, point: vec3<f32>) -> Ray {
    if view.scale.w != 1.0 {
        return Ray(point, normalize(to_local(instance, view.away.xyz)), -3.4e38);
    }
    let offset = vec3(instances[instance].x.w, instances[instance].y.w, instances[instance].z.w);
    let from_eye = point - to_local(instance, -offset);
    let length = length(from_eye);
    return Ray(point, select(vec3(0.0), from_eye / length, length > 0.0), -length);
}

// Share of the range between four texels of a level.
fn share_in(uv: vec2<f32>, at: u32) -> f32 {
    let size = vec2<i32>(textureDimensions(depths, at));
    let scaled = max(uv * vec2<f32>(size) - 0.5, vec2(0.0));
    let first = min(vec2<i32>(scaled), max(size - 2, vec2(0)));
    let part = min(scaled - vec2<f32>(first), vec2(1.0));
    let last = min(first + 1, size - 1);
    let a = f32(textureLoad(depths, first, at).x);
    let b = f32(textureLoad(depths, vec2(last.x, first.y), at).x);
    let c = f32(textureLoad(depths, vec2(first.x, last.y), at).x);
    let d = f32(textureLoad(depths, last, at).x);
    return mix(mix(a, b, part.x), mix(c, d, part.x), part.y) * (1.0 / 65535.0);
}

fn share(uv: vec2<f32>, lod: f32) -> f32 {
    let last = frames.size.w - 1.0;
    let clamped = clamp(lod, 0.0, last);
    let fine = min(floor(clamped), last);
    let mixed = clamped - fine;
    let near = share_in(uv, u32(fine));
    if mixed == 0.0 {
        return near;
    }
    return near + (share_in(uv, u32(fine) + 1u) - near) * mixed;
}

// Where a ray enters and leaves the box around what is shown.
fn chord(ray: Ray) -> vec2<f32> {
    var range = vec2(ray.start, 3.4e38);
    for (var axis = 0u; axis < 3u; axis++) {
        if ray.direction[axis] == 0.0 {
            if ray.point[axis] < frames.low[axis] || ray.point[axis] > frames.high[axis] {
                return vec2(1.0, 0.0);
            }
            continue;
        }
        let inverse = 1.0 / ray.direction[axis];
        let a = (frames.low[axis] - ray.point[axis]) * inverse;
        let b = (frames.high[axis] - ray.point[axis]) * inverse;
        range = vec2(max(range.x, min(a, b)), min(range.y, max(a, b)));
    }
    return range;
}

fn hit_of(ray: Ray, inside: vec2<f32>, number: u32, item: u32, lod: f32) -> Hit {
    let missed = Hit(vec2(0.0), 0.0, 1.0, false);
    if number >= arrayLength(&frame) {
        return missed;
    }
    let at = frame[number];
    let cosine = -dot(ray.direction, at.toward.xyz);
    if at.toward.w == 0.0 || cosine < LEAST_COSINE {
        return missed;
    }
    let from_center = ray.point - frames.center.xyz;
    let reach = frames.center.w;
    let height = dot(from_center, at.toward.xyz);
    let here = vec2(dot(from_center, at.right.xyz), dot(from_center, at.up.xyz));
    let across = vec2(dot(ray.direction, at.right.xyz), dot(ray.direction, at.up.xyz));
    let scale = vec2(0.5, -0.5) / reach;
    let step_count = items[item].step_count;
    var along = height / cosine;
    if step_count > 0u {
        along = clamp(along, inside.x, inside.y);
    }
    var met = 0.5 + (here + across * along) * scale;
    var last = 0.0;
    for (var step = 0u; step < step_count; step++) {
        last = share(at.corner.xy + clamp(met, vec2(0.0), vec2(1.0)) * frames.size.xy, lod);
        along = (height - (last * 2.0 - 1.0) * reach) / cosine;
        met = 0.5 + (here + across * along) * scale;
    }
    if any(met < vec2(0.0)) || any(met > vec2(1.0)) {
        return missed;
    }
    let uv = at.corner.xy + met * frames.size.xy;
    var trust = 1.0;
    let tolerance = items[item].tolerance;
    if step_count == 0u {
        along = (height - (share(uv, lod) * 2.0 - 1.0) * reach) / cosine;
    } else if tolerance > 0.0 {
        let off = 2.0 * (share(uv, lod) - last) / tolerance;
        trust = 1.0 / (1.0 + off * off);
    }
    return Hit(uv, along, trust, along > ray.start);
}

// Texels along the rows and columns of a frame where a ray meets its plane; z: 1 if it does.
fn on_plane(ray: Ray, number: u32) -> vec3<f32> {
    let at = frame[number];
    let cosine = -dot(ray.direction, at.toward.xyz);
    let from_center = ray.point - frames.center.xyz;
    let met = from_center + ray.direction * (dot(from_center, at.toward.xyz) / cosine);
    let texel = frames.size.z / (2.0 * frames.center.w);
    return vec3(dot(met, at.right.xyz) * texel, dot(met, at.up.xyz) * texel,
        select(0.0, 1.0, cosine >= LEAST_COSINE && at.toward.w == 1.0));
}

fn irradiance(normal: vec3<f32>) -> vec3<f32> {
    let anywhere = max(1.0 - length(normal), 0.0) * 0.25;
    let light = frames.light;
    return light.sun.xyz * (max(dot(normal, light.sun_direction.xyz), 0.0) + anywhere)
        + light.sky.xyz * (0.5 + 0.5 * normal.y)
        + light.ground.xyz * (0.5 - 0.5 * normal.y);
}

fn look(in: Corner) -> Seen {
    let instance = in.what.y;
    let a = instances[instance].params[0];
    let b = instances[instance].params[1];
    let chosen = vec3<u32>(a.xyz);
    let weights = vec3(a.w, b.xy);
    let ray = ray_through(instance, in.local);
#if TRILINEAR
    var heaviest = 0u;
    for (var i = 1u; i < 3u; i++) {
        if weights[i] > weights[heaviest] {
            heaviest = i;
        }
    }
    let plane = on_plane(ray, chosen[heaviest]);
    let steps = level(dpdxFine(plane.xy), dpdyFine(plane.xy));
    let lod = select(0.0, steps, plane.z == 1.0);
#else
    let lod = 0.0;
#endif
    let inside = chord(ray);
    var hits: array<Hit, 3>;
    var sum = 0.0;
    var trusted = 0.0;
    if inside.x > inside.y {
        return Seen(vec3(0.0), vec3(0.0), vec3(0.0), 0.0, 0.0);
    }
    for (var i = 0u; i < 3u; i++) {
        hits[i].there = false;
        if weights[i] > 0.0 {
            hits[i] = hit_of(ray, inside, chosen[i], in.what.x, lod);
            sum += weights[i];
            trusted += weights[i] * select(1.0, hits[i].trust, hits[i].there);
        }
    }
    var lit = vec4(0.0);
    var base = vec4(0.0);
    var normal = vec3(0.0);
    var along = 0.0;
    for (var i = 0u; i < 3u; i++) {
        if !hits[i].there {
            continue;
        }
        let weight = weights[i] * hits[i].trust * (sum / trusted);
        let texel = textureSampleLevel(colors, color_sampler, hits[i].uv, lod) * weight;
        base += texel;
        along += texel.w * hits[i].along;
#if RELIT
        let stored = textureSampleLevel(normal_map, normal_sampler, hits[i].uv, lod);
        let up = stored.xyz * 2.0 - 1.0;
        let t = stored.w * frames.light.sun_direction.w;
        lit += vec4(texel.xyz * mix(irradiance(up), irradiance(-up), t), texel.w);
        normal += up * texel.w;
#else
        lit += texel;
        normal += frame[chosen[i]].toward.xyz * texel.w;
#endif
    }
    if base.w <= 0.0 {
        return Seen(vec3(0.0), vec3(0.0), vec3(0.0), 0.0, 0.0);
    }
    let point = ray.point + ray.direction * (along / base.w);
    let place = clip(on_picture(instance, point));
    let z = select(0.0, place.z / place.w, place.w > 0.0);
    return Seen(lit.xyz / base.w, base.xyz / base.w, normal, base.w, z);
}
