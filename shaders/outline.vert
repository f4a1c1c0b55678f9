#version 330
// An avatar's hull, pushed outwards in the picture: its far side, drawn behind the avatar, is a line round it.
//
//     clip' = clip + w * unit(n) * 2 width / size       n: the normal as the picture shows it
//
// Times w, so that the line is as wide near the eye as far away.
#include "frame.glsl"
#include "posed.glsl"

uniform vec2 width;  // of the line, pixels over half the picture's size

const float BEHIND = 0.02;  // metres along the line of sight: folds less deep than this get no line

in vec3 normal;  // canonical, unit

void main() {
    vec3 position_view = posed(), normal_view = posed_normal(normal);
    position_view *= 1.0 + BEHIND * inversesqrt(max(dot(position_view, position_view), 1e-12));
    gl_Position = clip_from_view * vec4(position_view, 1.0);
    gl_Position.z = min(gl_Position.z, gl_Position.w);  // the far plane is right behind the avatar
    // what the normal moves in the picture, pixels; the floor keeps a normal along the line of sight where it is
    vec2 along = (mat3(clip_from_view) * normal_view).xy / width;
    gl_Position.xy += gl_Position.w * width * along / max(length(along), 1e-6);
}
