// Measures of a texel in u_measure. A negative value means: not measured yet.

float measure_at(ivec2 texel, int number)
{
    float measured[MAX_COMPONENTS];
    read_measure(texel, measured);
    return measured[number];
}
