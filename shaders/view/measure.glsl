// Measures of a texel in u_measure; negative where none exists yet.

float measure_at(ivec2 texel, int number)
{
    float measured[12];
    read_measure(texel, measured);
    return measured[number];
}
