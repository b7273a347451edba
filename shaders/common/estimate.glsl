// Current material of a texel. u_estimate holds the components of all parameters, fixed and estimated, in the order of
// the model's table.

#include "material.glsl"

Material estimate_at(ivec2 texel)
{
    float c[MAX_COMPONENTS];
    read_estimate(texel, c);
    return material_from(c);
}
