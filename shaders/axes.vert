#version 330
// The world's axes from its origin as lines of so many pixels, one an instance: x red, y green, z blue.

uniform vec4 clip_from_axes[4];  // of x, of y, of z, of the origin; each axis as long as it is drawn
uniform vec2 half_pixel;         // half the line's width over half the picture's size

flat out vec3 paint;

const vec3 PAINTS[3] = vec3[3](vec3(0.90, 0.25, 0.25), vec3(0.35, 0.75, 0.30), vec3(0.30, 0.45, 0.95));
const float NEAREST = 0.01;  // metres before the lens

void main() {
    vec4 from = clip_from_axes[3], to = from + clip_from_axes[gl_InstanceID];
    // what lies behind the lens has no place in the picture: the line begins before it
    if (from.w < NEAREST && to.w > NEAREST) from = mix(from, to, (NEAREST - from.w) / (to.w - from.w));
    if (to.w < NEAREST && from.w > NEAREST) to = mix(to, from, (NEAREST - to.w) / (from.w - to.w));
    vec4 here = (gl_VertexID & 1) == 0 ? from : to;
    vec2 along = (to.xy / to.w - from.xy / from.w) / half_pixel;
    vec2 side = vec2(-along.y, along.x) / max(length(along), 1e-6);
    gl_Position = here;
    gl_Position.xy += here.w * half_pixel * (gl_VertexID < 2 ? side : -side);
    // nothing is cut off in depth
    gl_Position.z = 0.0;
    paint = PAINTS[gl_InstanceID];
}
