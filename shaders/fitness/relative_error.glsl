#include "common/observation.glsl"
#include "fitness/loss.glsl"

// How radiance grows with an sRGB code (IEC 61966-2-1), at a radiance.
float srgb_slope(float radiance)
{
    return radiance > 0.0031308 ? 2.4 / 1.055 * pow(radiance, 1.4 / 2.4) : 1.0 / 12.92;
}

// What an error of a highlight counts, of one of the diffuse samples: a model is off in proportion to what it renders,
// so that δ grows with a sample that is brighter than the texel's scale. With the δ of the diffuse part a highlight is an
// outlier until it is met to a few percent, and the descent never comes there.
// With NOISE, the standard deviation of the files' sRGB codes, δ is no less than what that is in radiance: in the dark a
// code is far less than δ, in a dark texel that one lamp lights far more.
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

// The weight of an error in least squares that minimise the loss (iteratively reweighted).
vec3 reweighted(Texel t, Observation o, vec3 error, float relative)
{
    return o.weight * relative * relative * draws(o, error) * loss_weight(loss_scale(t.scale) * relative * error);
}
