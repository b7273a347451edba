// The number of independent samples of a texel. An error that channels share (shifts, shading, JPEG's luminance) is one,
// not three.

// Sums over the samples of a texel. errors: w e² of every channel; together: (Σ √w e)² of the three; channels: w of the
// active ones.
struct ErrorSums {
    float errors;
    float together;
    float channels;
};

void clear_errors(out ErrorSums t)
{
    t.errors = 0.0;
    t.together = 0.0;
    t.channels = 0.0;
}

// Adds the error of a sample. weight: of each channel; counted: the sample's weight in each active channel.
void add_error(inout ErrorSums t, vec3 error, vec3 weight, vec3 counted)
{
    t.errors += dot(weight, error * error);
    float sum = dot(sqrt(weight), error);
    t.together += sum * sum;
    t.channels += dot(counted, vec3(1.0));
}

// From 1, where channels err independently, to 3. It divides the number of samples.
float alike_of(ErrorSums t)
{
    return t.errors > 0.0 ? clamp(t.together / t.errors, 1.0, 3.0) : 1.0;
}

// Channels less the free parameters, times ``alike_of``: the rest has to determine everything but the colours. 0 or less
// with too few samples.
float freedom_of(ErrorSums t)
{
    return t.channels - 0.5 * (1.0 + alike_of(t)) * float(FREE_COUNT);
}
