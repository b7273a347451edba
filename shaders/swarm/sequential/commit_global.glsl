// Pass C, over W×H texels, in place: a better candidate replaces the global best. This pass runs after all swarms have
// moved, so Eq. 4 always reads the global bests of the previous iteration.

bool texel_kernel(ivec2 texel)
{
    vec4 verdict = texelFetch(u_verdict, texel, 0);
    if (verdict.w < 0.0 || verdict.z == 0.0) {
        return false;
    }
    float x[MAX_DIMENSIONS];
    read_candidate_position(texel, x);
    write_best(x);
    o_fitness = verdict.x;
    return true;
}
