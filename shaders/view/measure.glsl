// Measures of a texel in u_measure. A negative value means: not measured yet. DEVIATIONS: they are at least those in
// u_least, which has the width of the range where the parameter is unknown whatever its deviation.

float measure_at(ivec2 texel, int number)
{
    float measured[MAX_COMPONENTS];
    read_measure(texel, measured);
#ifdef DEVIATIONS
    float least = texelFetch(u_least, texel, 0).x;
    return least > measured[number] ? least : measured[number]; // a NaN stays
#else
    return measured[number];
#endif
}
