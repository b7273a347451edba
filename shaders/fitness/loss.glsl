// The loss of an error, and the weight with which least squares minimise it (iteratively reweighted least squares;
// Holland & Welsch 1977, Robust Regression Using Iteratively Reweighted Least-Squares).

#define FITNESS_L1 0
#define FITNESS_L2 1
#define FITNESS_ROBUST 2
#define FITNESS_GEMAN_MCCLURE 3

// The factor on errors before the loss: a robust loss counts them in δ of the texel's own scale (scale_at).
float loss_scale(float scale)
{
#if FITNESS == FITNESS_ROBUST || FITNESS == FITNESS_GEMAN_MCCLURE
    return 1.0 / (scale * u_delta);
#else
    return 1.0;
#endif
}

float loss_of(vec3 error)
{
#if FITNESS == FITNESS_L1
    error = abs(error);
#elif FITNESS == FITNESS_L2
    error = error * error;
#elif FITNESS == FITNESS_GEMAN_MCCLURE
    // Geman & McClure 1987, Statistical Methods for Tomographic Image Reconstruction: no sample costs more than 1, so
    // the mean measures the fit of the majority.
    error = error * error / (1.0 + error * error);
#else
    // Cauchy's loss: the cost of a sample in cast shadow or on a reflection hardly grows with its error.
    error = log(1.0 + error * error);
#endif
    return error.r + error.g + error.b;
}

// Loss′(e) / e, up to a constant factor.
vec3 loss_weight(vec3 error)
{
#if FITNESS == FITNESS_L1
    // 1e-4 of white bounds the weight 1 / |e|.
    return 1.0 / max(abs(error), vec3(1e-4));
#elif FITNESS == FITNESS_L2
    return vec3(1.0);
#elif FITNESS == FITNESS_GEMAN_MCCLURE
    vec3 inside = 1.0 / (1.0 + error * error);
    return inside * inside;
#else
    return 1.0 / (1.0 + error * error);
#endif
}
