// Evaluates one BRDF term, chosen by the define TERM, at the arguments in u_arguments; writes it to o_value.x.

#include "brdf/d_beckmann.glsl"
#include "brdf/d_ggx.glsl"
#include "brdf/e_coat.glsl"
#include "brdf/e_specular.glsl"
#include "brdf/f_dielectric.glsl"
#include "brdf/f_schlick.glsl"
#include "brdf/fd_lambert.glsl"
#include "brdf/g_v_cavity.glsl"
#include "brdf/horizon.glsl"
#include "brdf/v_smith_ggx.glsl"

bool texel_kernel(ivec2 texel)
{
    vec4 x = texelFetch(u_arguments, texel, 0);
    o_value = vec4(TERM, 0.0, 0.0, 1.0);
    return true;
}
