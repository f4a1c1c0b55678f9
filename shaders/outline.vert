#version 330
// An avatar's hull, pushed outwards in the picture: its far side, drawn behind the avatar, is a line round it.
//
//     clip' = clip + w * unit(n) * 2 width / size       n: the normal as the picture shows it
//
// Times w, so that the line is as wide near the eye as far away. The normal goes through the same blend as the point:
// skinned(x + n) - skinned(x), which is linear in n for either SKINNING.
#include "frame.glsl"
#if SKINNING == 0
#include "skinning.glsl"
#else
#include "skinning_dual.glsl"
#endif
#include "face.glsl"

#if LOOSE != 0
#include "loose.glsl"

in uvec4 near_particles;
in vec4 follows;
#endif

uniform vec2 width;  // of the line, pixels over half the picture's size

const float BEHIND = 0.02;  // metres along the line of sight: folds less deep than this get no line

in vec3 position;  // canonical (big pose), metres
in uvec4 joints;   // heaviest first
in vec4 weights;   // sum to 1
in vec3 normal;    // canonical, unit

void main() {
    vec3 point = faced(position), position_view = skinned(point, joints, weights);
    vec3 normal_view = skinned(point + faced_normal(normal), joints, weights) - position_view;
#if LOOSE != 0
    position_view += loosened(near_particles, follows);
#endif
    position_view *= 1.0 + BEHIND * inversesqrt(max(dot(position_view, position_view), 1e-12));
    gl_Position = clip_from_view * vec4(position_view, 1.0);
    gl_Position.z = min(gl_Position.z, gl_Position.w);  // the far plane is right behind the avatar
    // what the normal moves in the picture, pixels; the floor keeps a normal along the line of sight where it is
    vec2 along = (mat3(clip_from_view) * normal_view).xy / width;
    gl_Position.xy += gl_Position.w * width * along / max(length(along), 1e-6);
}
