// Over W×H texels: sums the residual losses of the fit. Writes o_noise: (sum of losses in loss_unit(), number of the
// samples' channels, 0, 0), and o_mean: the estimates, as input of the neighbours' pools.

#include "common/estimate.glsl"
#include "fitness/fitness.glsl"
#include "spatial_prior/loss_unit.glsl"

bool texel_kernel(ivec2 texel)
{
    float sum = 0.0;
    float channels = 0.0;
    if (state_at(texel) == TEXEL_SOLVED) {
        Texel t = observed_texel(texel);
        Material s = estimate_at(texel);
        float inverse_delta = inverse_delta_of(t.radiance_scale);
        Observation o;
        EACH_OBSERVATION(t, o) {
            vec3 error = error_of(o, reflectance(s, o.l, o.v));
            sum += weighted_loss(o, error, inverse_delta * error_scale(t, o));
            channels += o.weight * dot(active_channels(o, error), vec3(1.0));
        }
    }
    o_noise = vec4(sum / loss_unit(texel), channels, 0.0, 0.0);
    float c[MAX_COMPONENTS];
    read_estimate(texel, c);
    write_mean(c);
    return true;
}
