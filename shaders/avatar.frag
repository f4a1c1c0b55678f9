#version 330
// See avatar.vert. Colours are sRGB as stored and as shown: nothing is converted.
#if VIEW_STAGE == 2
#include "view_model.glsl"

in vec3 tangent;
#endif

#if LIT != 0
#include "lit.glsl"

#if LIT == 1
in float light_here;
#else
in vec3 light_here;
#endif
#endif

#if CONTACT != 0
in float openness;
#endif

uniform sampler2D base_color;

in vec2 surface_uv;

#if VIEW_STAGE == 1
in vec3 residual;
#endif

out vec4 color;

void main() {
    vec3 base = texture(base_color, surface_uv).rgb;
#if VIEW_STAGE == 1
    base = clamp(base + residual, 0.0, 1.0);
#endif
#if VIEW_STAGE == 2
    base = clamp(base + view_residual_at(surface_uv, tangent), 0.0, 1.0);
#endif
#if LIT != 0
    base = lit(base, light_here);
#endif
#if CONTACT != 0
    base = min(base, 1.0) * openness;
#endif
    color = vec4(base, 1.0);
}
