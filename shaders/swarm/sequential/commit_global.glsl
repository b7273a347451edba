// Pass C, over W×H texels, in place: takes the candidate as global best where it is one. All swarms do so at once,
// after all have moved, so that Eq. 4 always sees the bests of the iteration before.

bool texel_kernel(ivec2 texel)
{
    vec4 verdict = texelFetch(u_verdict, texel, 0);
    if (verdict.w < 0.0 || verdict.z == 0.0) {
        return false;
    }
    o_best_0 = texelFetch(u_candidate_position_0, texel, 0);
#if BLOCKS > 1
    o_best_1 = texelFetch(u_candidate_position_1, texel, 0);
#endif
    o_fitness = verdict.x;
    return true;
}
