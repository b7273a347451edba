// The materials that the surface shares (solver/phases/mixture.py): Gaussians over all free parameters but the normal.
// Reads u_materials, one column per material: rows 0 to 2 the means of 12 numbers, rows 3 to 5 their inverse variances,
// row 6 in x the material's share of the surface.

#include "free_parameters.glsl"

// Two searched numbers are alike if they differ by less than this fraction of their range; linear ones, if their roots do.
#define ALIKE_SEARCHED 0.1
#define ALIKE_LINEAR 0.15

float material_number(int row, int k, int u)
{
    return texelFetch(u_materials, ivec2(k, row + u / 4), 0)[u % 4];
}

// The share of the surface with a material like this one, from 0 to 1.
float share_of(inout float c[12])
{
    float share = 0.0;
    int count = textureSize(u_materials, 0).x;
    for (int k = 0; k < count; k++) {
        float apart = 0.0;
        for (int u = 0; u < FREE_COUNT; u++) {
            if (is_normal(u)) {
                continue;
            }
            FreeParameter free = free_at(u);
            float x = clamp((c[free.at] - free.low) / free.width, 0.0, 1.0);
            float d = (searched(u) ? x / ALIKE_SEARCHED : sqrt(x) / ALIKE_LINEAR) - material_number(0, k, u);
            apart += d * d * material_number(3, k, u);
        }
        share += texelFetch(u_materials, ivec2(k, 6), 0).x * exp(-0.5 * apart);
    }
    return share;
}

// Puts a material's numbers into c, except the normal.
void take_material(int k, inout float c[12])
{
    for (int u = 0; u < FREE_COUNT; u++) {
        if (is_normal(u)) {
            continue;
        }
        FreeParameter free = free_at(u);
        float x = material_number(0, k, u) * (searched(u) ? ALIKE_SEARCHED : ALIKE_LINEAR);
        c[free.at] = free.low + free.width * clamp(searched(u) ? x : x * x, 0.0, 1.0);
    }
}

float votes_of_materials(inout float c[12])
{
    return MATERIALS_WEIGHT * share_of(c);
}
