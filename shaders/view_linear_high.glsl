// Linear view dependence over eight features, as view_linear.glsl over four; `more` are features 4 to 7.
#include "linear_constants.glsl"

vec3 view_residual(vec4 features, vec4 more, vec3 tangent) {
    mat3 M = features.x * LINEAR_0 + features.y * LINEAR_1 + features.z * LINEAR_2 + features.w * LINEAR_3;
    M += more.x * LINEAR_4 + more.y * LINEAR_5 + more.z * LINEAR_6 + more.w * LINEAR_7;
    return M * tangent;
}
