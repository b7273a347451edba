// The current material of a texel, fixed or estimated: u_estimate holds the components of all parameters, in the order of
// the model's table.

#include "material.glsl"

Material estimate_at(ivec2 texel)
{
    float c[12];
    read_estimate(texel, c);
    return material_from(c);
}
