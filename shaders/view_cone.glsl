// How far the view direction d leaves the global one d̄ (TotalSelfScan Eq. 14), inside the cone that training saw.
// All in the canonical frame; d and mean are unit, from the eye to the surface.
//
//     t  = d - (d.d̄) d̄
//     t' = u_view v t / sqrt(1 + tᵀ Q t)
//
// Q = a1 a1ᵀ + a2 a2ᵀ is given as (xx, xy, xz) and (yy, yz, zz); as a matrix it may be interpolated, its axes may
// not (they have no sign). v in [0,1] is how well the point was seen. There is no angle, hence no acos, here.
vec3 cone_tangent(vec3 d, vec3 mean, vec3 q0, vec3 q1, float seen) {
    vec3 t = d - dot(d, mean) * mean;
    float spread = dot(t, vec3(dot(q0, t), dot(vec3(q0.y, q1.xy), t), dot(vec3(q0.z, q1.yz), t)));
    return view_amount * seen * t * inversesqrt(1.0 + max(spread, 0.0));  // rounding may leave Q a hair below 0
}
