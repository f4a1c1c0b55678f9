// How much of the sky above a surface a body's capsules leave, player/effects/contact_capsules.py. View space, metres.
// Mirrored by player/gl/blocks.py, CAPSULES.
layout(std140) uniform Capsules {
    vec4 capsule_start[16];  // and its radius; 0: there is none
    vec4 capsule_along[16];  // to its other end; 1 / its length squared
};

const float LEAST_HIDDEN = 0.03;

// grown: of the radii; first, end: the capsules that are looked at
float open_sky(vec3 p, vec3 n, uint spared, float grown, int first, int end) {
    float open = 1.0;
    for (int k = first; k < end; k++) {
        vec3 from = p - capsule_start[k].xyz;
        float share = clamp(dot(from, capsule_along[k].xyz) * capsule_along[k].w, 0.0, 1.0);
        vec3 towards = share * capsule_along[k].xyz - from;
        // a surface inside a capsule: no division by less than a tenth of a millimetre
        float l2 = max(dot(towards, towards), 1e-8), r = grown * capsule_start[k].w, r2 = r * r;
        float hidden = max(dot(n, towards), 0.0) * inversesqrt(l2) * r2 / max(l2, r2);
        hidden = max(hidden - LEAST_HIDDEN, 0.0) / (1.0 - LEAST_HIDDEN);
        open *= ((spared >> uint(k)) & 1u) == 0u ? 1.0 - hidden : 1.0;
    }
    return open;
}
