// Normal equations of a texel's samples, reduced to the normal. Reads the sample stack and u_noise.

#include "refine/linearise.glsl"
#include "diagnostics/sweep.glsl"

// Returns the variance of the noise. a: the Schur complement of the normal's two angles, J per range; between them and
// another parameter, minus its change per change of the angle. A weak prior (σ = the range) is added to every
// parameter.
float eliminate_all_but_normal(ivec2 texel, inout float c[MAX_COMPONENTS], out float a[FREE_COUNT * FREE_COUNT])
{
    float slope[FREE_COUNT];
    linearise(observed_texel(texel), c, a, slope);
    // A lower bound for samples without noise: a millionth of the texel's scale.
    float level = u_mean_irradiance * radiance_scale_at(texel);
    float noise = max(texelFetch(u_noise, texel, 0).w, 1e-12 * level * level);
    for (int u = 0; u < FREE_COUNT; u++) {
        a[u * FREE_COUNT + u] += noise;
        for (int k = 0; k < u; k++) {
            a[u * FREE_COUNT + k] = a[k * FREE_COUNT + u];
        }
    }
    for (int u = 0; u < FREE_COUNT; u++) {
        if (!is_normal(u)) {
            sweep(a, u);
        }
    }
    return noise;
}
