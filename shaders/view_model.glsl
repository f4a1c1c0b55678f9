// How an avatar's colour leaves its base at a place of the atlas: VIEW_MODEL 0 linear, 1 network; VIEW_STAGE 1 looks
// its features up per vertex, 2 per pixel.
#if VIEW_MODEL == 1
#include "view_network.glsl"
#else
#include "view_linear.glsl"
#endif

uniform sampler2D features;

vec3 view_residual_at(vec2 uv, vec3 tangent) {
#if VIEW_STAGE == 1
    return view_residual(textureLod(features, uv, 0.0), tangent);  // a vertex has no neighbours to choose a mip by
#else
    return view_residual(texture(features, uv), tangent);
#endif
}
