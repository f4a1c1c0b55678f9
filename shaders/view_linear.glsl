// Linear view dependence:  residual = (sum_i f_i M_i) t'  with four global 3x3 matrices over the four features.
// LINEAR_0 .. LINEAR_3 are constants of one avatar, written by player/gl/constants.py.
#include "linear_constants.glsl"

vec3 view_residual(vec4 features, vec3 tangent) {
    mat3 M = features.x * LINEAR_0 + features.y * LINEAR_1 + features.z * LINEAR_2 + features.w * LINEAR_3;
    return M * tangent;
}
