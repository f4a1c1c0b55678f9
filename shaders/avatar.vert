#version 330
// A posed avatar; SKINNING, LOOSE and FACE as in posed.glsl.
// VIEW_STAGE: 0 paper mode, 1 view dependence per vertex, 2 per pixel.
// LIT: 0 the light of the videos is in the colours; the surface is lit anew (light.glsl): 1 without highlights, 2 with
// them, 3 with them and in a power of the colours.
// CONTACT: 1 limbs that come near darken it (contact.glsl).
// VIEW_MODEL: see view_model.glsl (asked only when VIEW_STAGE is not 0).
#include "frame.glsl"
#include "posed.glsl"

in vec2 uv;  // v down

out vec2 surface_uv;

#if LIT != 0
#include "directions.glsl"
in vec3 normal;      // canonical, unit
in vec2 seen_light;  // S and H that the base colour shows
#include "light.glsl"
#if LIT == 1
out float light_here;
#else
out vec3 light_here;
#endif
#endif

#if CONTACT != 0
#include "contact.glsl"
#if LIT == 0
in vec3 normal;    // canonical, unit
#endif
in uint spared;    // bits of the capsules that do not darken it
in float rest;     // openness in the pose it rests in
uniform float darkening;
out float openness;
#endif

#if VIEW_STAGE != 0
#include "directions.glsl"
in vec3 view_mean;  // global view direction, unit
in vec3 view_q0;    // cone: xx xy xz
in vec3 view_q1;    //       yy yz zz
in float view_seen; // 0 = never seen
#include "view_cone.glsl"
#if VIEW_STAGE == 1
#include "view_model.glsl"
out vec3 residual;
#else
// It is smooth over a triangle, unlike what the network makes of it: interpolated, pictures are 68 dB from those with
// all four of its ingredients interpolated (30k triangles; 62 dB at 3k), and cost 8 % less in software.
out vec3 tangent;
#endif
#endif

void main() {
    vec3 position_view = posed();
    gl_Position = clip_from_view * vec4(position_view, 1.0);
    surface_uv = uv;
#if CONTACT != 0
    vec3 normal_view = posed_normal(normal);
    normal_view *= inversesqrt(max(dot(normal_view, normal_view), 1e-12));
    float open = open_sky(position_view, normal_view, spared, 1.0, 0, 16) / max(rest, 1e-3);
    openness = 1.0 - darkening * (1.0 - clamp(open, 0.0, 1.0));
#endif
#if LIT != 0
    // R(q) n: turned_back by the conjugate
    vec4 turn = blended_turn(joints, weights);
    vec3 lit_normal = turned_back(vec4(-turn.xyz, turn.w), faced_normal(normal));
    light_here = light_factors(seen_light, lit_normal, unit(-position_view));
#endif
#if VIEW_STAGE != 0
    vec3 direction_canonical = turned_back(blended_turn(joints, weights), unit(position_view));
    vec3 off_mean = cone_tangent(direction_canonical, view_mean, view_q0, view_q1, view_seen);
#if VIEW_STAGE == 1
    residual = view_residual_at(uv, off_mean);
#else
    tangent = off_mean;
#endif
#endif
}
