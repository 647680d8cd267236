// A texture on a shape. The twin of texture/texture.rs; texels are stored premultiplied and linear.

@group(3) @binding(0) var leaves: texture_2d<f32>;
@group(3) @binding(1) var leaf_sampler: sampler;

fn look(in: Corner) -> Texel {
#if TRILINEAR
    let size = vec2<f32>(textureDimensions(leaves));
    let lod = level(dpdxFine(in.uv) * size, dpdyFine(in.uv) * size);
#else
    let lod = 0.0;
#endif
    return straight(textureSampleLevel(leaves, leaf_sampler, in.uv, lod));
}
