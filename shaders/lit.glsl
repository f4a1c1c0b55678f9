// What light.glsl found at the vertices, on a base colour. May be brighter than 1, which bytes do not hold.
#if LIT == 3
uniform float gamma;
#endif

#if LIT == 1
vec3 lit(vec3 base, float factor) {
    return base * factor;
}
#else
vec3 lit(vec3 base, vec3 factors) {
#if LIT == 3
    base = pow(max(base, 1e-4), vec3(gamma));
#endif
    vec3 shown = max(base - factors.y, 0.0) * factors.x + factors.z;
#if LIT == 3
    shown = pow(clamp(shown, 1e-6, 1.0), vec3(1.0 / gamma));
#endif
    return shown;
}
#endif
