#include "common/observation.glsl"
#include "fitness/loss.glsl"

// Returns d radiance / d code of sRGB (IEC 61966-2-1).
float srgb_derivative(float radiance)
{
    return radiance > 0.0031308 ? 2.4 / 1.055 * pow(radiance, 1.4 / 2.4) : 1.0 / 12.92;
}

// Returns the factor on a sample's error: 1 for diffuse samples, less in highlights. A model's error is proportional to
// its render, so δ grows with samples that are brighter than the texel's scale. With the diffuse δ a highlight would be
// an outlier until the fit is within a few percent, and the descent never gets there.
// NOISE is the standard deviation of the files' sRGB codes. It adds the noise in radiance to δ, in quadrature. In a
// dark texel that only one lamp lights, the noise exceeds δ.
float error_scale(Texel t, Observation o)
{
#if (LOSS == LOSS_CAUCHY || LOSS == LOSS_GEMAN_MCCLURE)
    float level = t.radiance_scale * u_mean_irradiance;
    float brightest = max(o.radiance.r, max(o.radiance.g, o.radiance.b));
    float scale = brightest > level ? pow(level / brightest, HIGHLIGHT_POWER) : 1.0;
#if defined(NOISE) && !defined(GREY)
    float delta = 1.0 / (inverse_delta_of(t.radiance_scale) * scale);
    float noise = NOISE * srgb_derivative(clamp(brightest, 0.0, 1.0));
    scale *= delta * inversesqrt(delta * delta + noise * noise);
#endif
    return scale;
#else
    return 1.0;
#endif
}

// Returns the weighted loss of a sample's error. scale_over_delta: error_scale() / δ.
float weighted_loss(Observation o, vec3 error, float scale_over_delta)
{
    return o.weight * loss_of(scale_over_delta * error);
}

// Returns the weight of an error in iteratively reweighted least squares. scale: error_scale().
vec3 reweighted(Texel t, Observation o, vec3 error, float scale)
{
    vec3 weight = loss_weight(inverse_delta_of(t.radiance_scale) * scale * error);
    return o.weight * scale * scale * active_channels(o, error) * weight;
}
