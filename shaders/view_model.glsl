// How an avatar's colour leaves its base at a place of the atlas: VIEW_MODEL 0 linear, 1 network; VIEW_FEATURES 4 or
// 8 of them a texel, the second four in a texture of their own; VIEW_STAGE 1 looks them up per vertex, 2 per pixel.
#if VIEW_FEATURES == 8
#if VIEW_MODEL == 1
#include "view_network_high.glsl"
#else
#include "view_linear_high.glsl"
#endif
#else
#if VIEW_MODEL == 1
#include "view_network.glsl"
#else
#include "view_linear.glsl"
#endif
#endif

uniform sampler2D features;
#if VIEW_FEATURES == 8
uniform sampler2D more_features;
#endif

vec4 looked_up(sampler2D image, vec2 uv) {
#if VIEW_STAGE == 1
    return textureLod(image, uv, 0.0);  // a vertex has no neighbours to choose a mip by
#else
    return texture(image, uv);
#endif
}

vec3 view_residual_at(vec2 uv, vec3 tangent) {
#if VIEW_FEATURES == 8
    return view_residual(looked_up(features, uv), looked_up(more_features, uv), tangent);
#else
    return view_residual(looked_up(features, uv), tangent);
#endif
}
