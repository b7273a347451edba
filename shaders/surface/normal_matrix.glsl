// The normal equations of a texel's samples, in which the other free numbers follow its normal. Reads the sample stack and
// u_noise.

#include "refine/linearise.glsl"
#include "diagnostics/sweep.glsl"

// Returns the variance of the noise. a: the Schur complement of the normal's two angles, J per range, and between them and
// another number how that follows. Each number has its range for a standard deviation beside what the samples say of it.
float eliminated(ivec2 texel, inout float c[12], out float a[FREE_COUNT * FREE_COUNT])
{
    float slope[FREE_COUNT];
    linearise(observed_texel(texel), c, a, slope);
    // 1e-12: samples without any noise.
    float noise = max(texelFetch(u_noise, texel, 0).w, 1e-12);
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
