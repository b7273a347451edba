// Penalty of a refinement on the samples alone: none.

float penalty_of(ivec2 texel, inout float c[MAX_COMPONENTS])
{
    return 0.0;
}

void add_penalty(ivec2 texel, inout float c[MAX_COMPONENTS], inout float a[FREE_COUNT * FREE_COUNT],
                 inout float gradient[FREE_COUNT])
{
}
