// Number of independent samples of a texel. An error that the channels share (misalignment, shading, JPEG's luminance)
// counts once, not three times.

// Sums over the samples of a texel. squares: w e² of every channel; joint: (Σ √w e)² over the three channels of a
// sample; channels: w of every active channel.
struct ErrorSums {
    float squares;
    float joint;
    float channels;
};

void clear_errors(out ErrorSums t)
{
    t.squares = 0.0;
    t.joint = 0.0;
    t.channels = 0.0;
}

// Adds the error of a sample. weight: w of each channel; counted: the sample's weight in active channels, 0 in others.
void add_error(inout ErrorSums t, vec3 error, vec3 weight, vec3 counted)
{
    t.squares += dot(weight, error * error);
    float sum = dot(sqrt(weight), error);
    t.joint += sum * sum;
    t.channels += dot(counted, vec3(1.0));
}

// Returns the factor by which shared errors reduce the number of samples: 1 for independent channels, at most 3.
float redundancy_of(ErrorSums t)
{
    return t.squares > 0.0 ? clamp(t.joint / t.squares, 1.0, 3.0) : 1.0;
}

// Returns the channels that remain after the free parameters, i.e. redundancy_of() times the remaining samples. Half of
// the parameters (the colours) use one channel each, the others redundancy_of() channels. Negative with few samples.
float degrees_of_freedom(ErrorSums t)
{
    return t.channels - 0.5 * (1.0 + redundancy_of(t)) * float(FREE_COUNT);
}
