#version 330
// Antialiasing of a finished picture: fast approximate antialiasing, T. Lottes 2009 (the five-tap form), where
// surfaces end. Colours are averaged along the edge that the four diagonal neighbours show.
//
// Reads the avatars as drawn over nothing, in display space, after all shading; the result is blended over the
// background, which stays as sharp as it is. All four channels are averaged alike, so premultiplied colours stay
// premultiplied.
//
// Lottes looks at contrast alone, and blurs eyes and letters with the outlines. Here an edge needs a step in depth:
//     | u_1 + u_2 - 2 u | > EDGE c u    for a pair of opposite neighbours, u = 1 / depth
// u is affine on the image of a plane, so slanted surfaces have no such step; c is the width of a pixel one metre
// away, so c u is what a pixel covers, as a share of the depth.
//
// The signal that shows the direction is luma + alpha, not luma: a black sleeve before nothing has an edge, too.
#include "frame.glsl"

uniform sampler2D picture;  // bilinear, clamped at its border
uniform sampler2D depth;    // of the same image, as rasterised; 1 where there is nothing

out vec4 color;

const float EDGE = 4.0;            // a step of four pixels' width is an edge
const float LEAST = 1.0 / 24.0;    // contrast that cannot be seen as one
const float RELATIVE = 1.0 / 8.0;  // the same, as a share of the brightest neighbour's luma
const float REDUCE_LEAST = 1.0 / 128.0;  // keeps the direction finite where the four corners agree
const float REDUCE = 1.0 / 8.0;
const float REACH = 8.0;  // pixels along the edge at most

float signal(vec4 c) {
    return dot(c.rgb, vec3(0.299, 0.587, 0.114)) + c.a;
}

void main() {
    ivec2 size = textureSize(picture, 0), here = ivec2(gl_FragCoord.xy), last = size - 1;
    ivec2 nw = clamp(here + ivec2(-1, -1), ivec2(0), last), ne = clamp(here + ivec2(1, -1), ivec2(0), last);
    ivec2 sw = clamp(here + ivec2(-1, 1), ivec2(0), last), se = clamp(here + ivec2(1, 1), ivec2(0), last);

    float z = texelFetch(depth, here, 0).r;
    vec4 around = vec4(texelFetch(depth, nw, 0).r, texelFetch(depth, se, 0).r,
                       texelFetch(depth, ne, 0).r, texelFetch(depth, sw, 0).r);
    float nearest = min(z, min(min(around.x, around.y), min(around.z, around.w)));
    float farthest = max(z, max(max(around.x, around.y), max(around.z, around.w)));
    if (nearest == 1.0) {
        discard;  // no avatar near
    }
    vec4 middle = texelFetch(picture, here, 0);
    // depth = clip_zz' / (2 z - 1 + clip_zz), so u is affine in z: differences of u are those of z, scaled
    float u = 2.0 * z - 1.0 + clip_from_view[2][2];
    vec2 bend = 2.0 * abs(around.xz + around.yw - 2.0 * z);
    float pixel = 2.0 / (float(size.y) * abs(clip_from_view[1][1]));
    bool outline = farthest == 1.0;
    if (!outline && max(bend.x, bend.y) < EDGE * pixel * abs(u)) {
        color = middle;
        return;
    }

    vec4 corners = vec4(signal(texelFetch(picture, nw, 0)), signal(texelFetch(picture, ne, 0)),
                        signal(texelFetch(picture, sw, 0)), signal(texelFetch(picture, se, 0)));
    float own = signal(middle);
    float low = min(own, min(min(corners.x, corners.y), min(corners.z, corners.w)));
    float high = max(own, max(max(corners.x, corners.y), max(corners.z, corners.w)));
    if (high - low < max(LEAST, RELATIVE * (high - 1.0))) {
        color = middle;
        return;
    }
    vec2 along = vec2((corners.z + corners.w) - (corners.x + corners.y),
                      (corners.x + corners.z) - (corners.y + corners.w));
    float reduce = max(0.25 * REDUCE * (dot(corners, vec4(1.0)) - 4.0 * low), REDUCE_LEAST);
    along = clamp(along / (min(abs(along.x), abs(along.y)) + reduce), -REACH, REACH) / vec2(size);
    vec2 place = gl_FragCoord.xy / vec2(size);
    vec4 near = 0.5 * (texture(picture, place - along / 6.0) + texture(picture, place + along / 6.0));
    vec4 far = 0.5 * near + 0.25 * (texture(picture, place - 0.5 * along) + texture(picture, place + 0.5 * along));
    float found = signal(far);
    color = found < low || found > high ? near : far;  // the far taps crossed into something else
}
