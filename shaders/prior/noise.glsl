// Over W×H texels: what the fit leaves of the samples. Writes o_noise: (sum of the losses in loss_unit(), number of the
// samples' channels, 0, 0), and o_mean_0 …: the estimates, as the neighbours are to see them.

#include "common/estimate.glsl"
#include "fitness/fitness.glsl"
#include "prior/loss_unit.glsl"

bool texel_kernel(ivec2 texel)
{
    float sum = 0.0;
    float channels = 0.0;
    if (state_at(texel) == TEXEL_SOLVED) {
        Frame f = frame_at(texel);
        Material s = estimate_at(texel);
        float scale = loss_scale(texel);
        for (int k = 0; k < u_observations; k++) {
            Observation o;
            if (!observe(texel, f, k, o)) {
                continue;
            }
            vec3 error = error_of(o, reflectance(s, o.l, view_at(f, k)));
            sum += o.weight * loss_of(scale * relative_error(texel, o) * error);
            channels += o.weight * dot(draws(o, error), vec3(1.0));
        }
    }
    o_noise = vec4(sum / loss_unit(texel), channels, 0.0, 0.0);
    o_mean_0 = texelFetch(u_estimate_0, texel, 0);
#if ESTIMATES > 1
    o_mean_1 = texelFetch(u_estimate_1, texel, 0);
#endif
#if ESTIMATES > 2
    o_mean_2 = texelFetch(u_estimate_2, texel, 0);
#endif
    return true;
}
