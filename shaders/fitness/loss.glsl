// Loss of an error, and the weight by which least squares minimise it (iteratively reweighted least squares;
// Holland & Welsch 1977, Robust Regression Using Iteratively Reweighted Least-Squares).

#define LOSS_L1 0
#define LOSS_L2 1
#define LOSS_CAUCHY 2
#define LOSS_GEMAN_MCCLURE 3

// Returns the factor on errors before the loss. Of a robust loss it is 1 / δ, with δ in radiance: u_delta times the
// texel's scale (radiance_scale_at). Other losses have no δ: 1.
float inverse_delta_of(float radiance_scale)
{
#if LOSS == LOSS_CAUCHY || LOSS == LOSS_GEMAN_MCCLURE
    return 1.0 / (radiance_scale * u_delta);
#else
    return 1.0;
#endif
}

float loss_of(vec3 error)
{
#if LOSS == LOSS_L1
    error = abs(error);
#elif LOSS == LOSS_L2
    error = error * error;
#elif LOSS == LOSS_GEMAN_MCCLURE
    // Geman & McClure 1987, Statistical Methods for Tomographic Image Reconstruction. The loss of a sample is at most
    // 1, so the mean measures the fit of the majority.
    error = error * error / (1.0 + error * error);
#else
    // Cauchy's loss grows slowly with the errors of outliers: samples in cast shadow or with reflections.
    error = log(1.0 + error * error);
#endif
    return error.r + error.g + error.b;
}

// Returns loss′(e) / e, up to a constant factor.
vec3 loss_weight(vec3 error)
{
#if LOSS == LOSS_L1
    // An error of 1e-4 of white bounds the weight 1 / |e|.
    return 1.0 / max(abs(error), vec3(1e-4 * u_mean_irradiance));
#elif LOSS == LOSS_L2
    return vec3(1.0);
#elif LOSS == LOSS_GEMAN_MCCLURE
    vec3 reciprocal = 1.0 / (1.0 + error * error);
    return reciprocal * reciprocal;
#else
    return 1.0 / (1.0 + error * error);
#endif
}
