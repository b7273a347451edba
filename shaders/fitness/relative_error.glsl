#include "common/observation.glsl"
#include "fitness/loss.glsl"

// The derivative of radiance by the sRGB code (IEC 61966-2-1), at a radiance.
float srgb_slope(float radiance)
{
    return radiance > 0.0031308 ? 2.4 / 1.055 * pow(radiance, 1.4 / 2.4) : 1.0 / 12.92;
}

// The factor on a sample's error: 1 for diffuse samples, less in highlights. A model's error is proportional to its render,
// so δ grows with a sample that is brighter than the texel's scale. With the diffuse δ a highlight is an outlier until it
// fits to a few percent, which the descent never reaches.
// With NOISE, the standard deviation of the files' sRGB codes, δ is at least that noise in radiance: in a dark texel that
// one lamp lights, it exceeds δ.
float relative_error(Texel t, Observation o)
{
#if (FITNESS == FITNESS_ROBUST || FITNESS == FITNESS_GEMAN_MCCLURE)
    float level = t.scale * u_brightness;
    float brightest = max(o.radiance.r, max(o.radiance.g, o.radiance.b));
    float relative = brightest > level ? pow(level / brightest, HIGHLIGHT_POWER) : 1.0;
#if defined(NOISE) && !defined(GREY)
    float delta = 1.0 / (loss_scale(t.scale) * relative);
    float noise = NOISE * srgb_slope(clamp(brightest, 0.0, 1.0));
    relative *= delta * inversesqrt(delta * delta + noise * noise);
#endif
    return relative;
#else
    return 1.0;
#endif
}

// The weight of an error in iteratively reweighted least squares.
vec3 reweighted(Texel t, Observation o, vec3 error, float relative)
{
    return o.weight * relative * relative * active_channels(o, error) * loss_weight(loss_scale(t.scale) * relative * error);
}
