// Materials that the surface shares (solver/phases/mixture.py): Gaussians over all free parameters but the normal.
// Reads u_materials, one column per material: rows 0 to 2 the means of 12 numbers, rows 3 to 5 their inverse variances,
// row 6 in x the fraction of the surface that has the material, by the texels' weights (shared_materials.py).

#include "free_parameters.glsl"

// Bandwidths of similar materials, the units of the means, as fractions of the range: of a searched number, and of the
// square root of a linear one.
#define SEARCHED_BANDWIDTH 0.1
#define LINEAR_BANDWIDTH 0.15

float material_number(int row, int k, int u)
{
    return texelFetch(u_materials, ivec2(k, row + u / 4), 0)[u % 4];
}

// Returns the fraction of the surface with a material similar to c, from 0 to 1.
float surface_fraction_of(inout float c[MAX_COMPONENTS])
{
    float fraction = 0.0;
    int count = textureSize(u_materials, 0).x;
    for (int k = 0; k < count; k++) {
        float squared_distance = 0.0;
        for (int u = 0; u < FREE_COUNT; u++) {
            if (is_normal(u)) {
                continue;
            }
            FreeParameter free = free_at(u);
            float x = clamp((c[free.at] - free.low) / free.width, 0.0, 1.0);
            float d = (searched(u) ? x / SEARCHED_BANDWIDTH : sqrt(x) / LINEAR_BANDWIDTH) - material_number(0, k, u);
            squared_distance += d * d * material_number(3, k, u);
        }
        fraction += texelFetch(u_materials, ivec2(k, 6), 0).x * exp(-0.5 * squared_distance);
    }
    return fraction;
}

// Copies the numbers of material k to c, except the normal.
void take_material(int k, inout float c[MAX_COMPONENTS])
{
    for (int u = 0; u < FREE_COUNT; u++) {
        if (is_normal(u)) {
            continue;
        }
        FreeParameter free = free_at(u);
        float x = material_number(0, k, u) * (searched(u) ? SEARCHED_BANDWIDTH : LINEAR_BANDWIDTH);
        c[free.at] = free.low + free.width * clamp(searched(u) ? x : x * x, 0.0, 1.0);
    }
}

float material_support_of(inout float c[MAX_COMPONENTS])
{
    return MATERIALS_WEIGHT * surface_fraction_of(c);
}
