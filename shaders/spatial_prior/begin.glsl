// Over W×H texels: starts the fit with a spatial prior. Every colour and scalar becomes the mean of the texel's
// estimate and the prior, weighted by precision. A texel keeps its estimate if the weight of the prior is below
// MIN_INFLUENCE in every number. Reads the estimates, their deviations, the prior in u_mean and u_deviation, u_noise.
// Writes o_estimate, o_status (refine/status.glsl) and o_penalty: the penalty of the estimates before the change.

#include "common/frame.glsl"
#include "refine/status.glsl"
#include "components.glsl"
#include "spatial_prior/penalty.glsl"

bool texel_kernel(ivec2 texel)
{
    float c[MAX_COMPONENTS];
    material_to(estimate_at(texel), c);
    Status status = fresh_status(0.0);
    o_penalty = 0.0;
    float max_influence = 0.0;
    if (state_at(texel) == TEXEL_SOLVED) {
        o_penalty = penalty_of(texel, c);
        float own_sigma[MAX_COMPONENTS];
        float mean[MAX_COMPONENTS];
        float deviation[MAX_COMPONENTS];
        read_own(texel, own_sigma);
        read_mean(texel, mean);
        read_deviation(texel, deviation);
        for (int i = 0; i < COMPONENTS; i++) {
            float width;
            int kind;
            component_at(i, width, kind);
            if (kind != COMPONENT_OTHER && deviation[i] > 0.0) {
                float own = own_sigma[i] * own_sigma[i];
                float influence = own / (own + deviation[i] * deviation[i]);
                c[i] += influence * (mean[i] - c[i]);
                max_influence = max(max_influence, influence);
            }
        }
    }
    if (!(max_influence >= MIN_INFLUENCE)) {
        material_to(estimate_at(texel), c);
        status.stalled = CONVERGED_AFTER;
    }
    o_status = stored_status(status);
    write_estimate(c);
    return true;
}
