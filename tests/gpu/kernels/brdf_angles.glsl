// Evaluates the angles of u_normal_in, u_light_in and u_view_in. Writes n·l, n·v, n·h, v·h to o_value, sin² to o_sine.

#include "brdf/angles.glsl"

bool texel_kernel(ivec2 texel)
{
    vec3 n = texelFetch(u_normal_in, texel, 0).xyz;
    vec3 l = texelFetch(u_light_in, texel, 0).xyz;
    vec3 v = texelFetch(u_view_in, texel, 0).xyz;
    Angles a = angles_of(n, l, v);
    o_value = vec4(a.NoL, a.NoV, a.NoH, a.VoH);
    o_sine = vec4(a.sin2_h, 0.0, 0.0, 1.0);
    return true;
}
