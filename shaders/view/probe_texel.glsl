// Reads out the texel (u_column, u_row) of the domain, in a row of ESTIMATES + 1 texels: the components of its
// estimate, then (mean absolute error, sum of weights, largest error, 1). All are 0 where the texel is not solved.
// Reads u_packed, the estimates, the geometry, the sample stack and the observation table.

#include "common/estimate.glsl"
#include "common/packing.glsl"
#include "diagnostics/mean_error.glsl"

bool texel_kernel(ivec2 place)
{
    ivec2 packed_texel = packed_at(ivec2(u_column, u_row));
    o_numbers = vec4(0.0);
    if (packed_texel.x < 0) {
        return true;
    }
    Material s = estimate_at(packed_texel);
    float c[MAX_COMPONENTS];
    material_to(s, c);
    if (place.x < ESTIMATES) {
        for (int i = 0; i < 4; i++) {
            o_numbers[i] = c[4 * place.x + i];
        }
    }
    else {
        o_numbers = vec4(mean_error(packed_texel, s).xyz, 1.0);
    }
    return true;
}
