// Over W×H texels: variance of the samples' noise. Few samples determine it badly, so it is pooled with the neighbours:
//   (S + ν N̄) / (n + ν), with S the texel's sum over n degrees of freedom, N̄ the neighbours' mean and ν its weight
// (Smyth 2004, Linear Models and Empirical Bayes Methods for Assessing Differential Expression in Microarray
// Experiments, its s̃²). Reads u_noise (noise.glsl), packing. Writes o_noise: as u_noise; z the variance, w in losses.

#include "common/frame.glsl"
#include "common/packing.glsl"
#include "spatial_prior/loss_unit.glsl"
#include "common/taps.glsl"

float degrees_of_freedom(vec4 noise)
{
    return max(noise.y - float(FREE_COUNT), 0.0);
}

bool texel_kernel(ivec2 texel)
{
    vec4 own = texelFetch(u_noise, texel, 0);
    if (state_at(texel) == TEXEL_SOLVED) {
        ivec4 place = surface_place_of(texel);
        float sum = 0.0;
        float freedom = 0.0;
        for (int t = 0; t < TAPS; t++) {
            ivec2 other = neighbour_at(place, tap_at(t));
            if (other.x >= 0) {
                vec4 noise = texelFetch(u_noise, other, 0);
                float n = degrees_of_freedom(noise);
                sum += n > 0.0 ? noise.x : 0.0;
                freedom += n;
            }
        }
        float mean_noise = freedom > 0.0 ? sum / freedom : 0.0;
        float weight = freedom > 0.0 ? NOISE_SAMPLES : 0.0;
        float n = degrees_of_freedom(own);
        float noise = n + weight > 0.0 ? ((n > 0.0 ? own.x : 0.0) + weight * mean_noise) / (n + weight) : 0.0;
#if LOSS == LOSS_L1
        own.z = 2.0 * noise * noise;
#else
        own.z = noise;
#endif
        own.w = noise;
    }
    o_noise = own;
    return true;
}
