// Pass C, over W×H texels, in place: the candidate becomes the global best if it is better. All swarms do so at once, after
// all have moved, so that Eq. 4 always reads the bests of the previous iteration.

bool texel_kernel(ivec2 texel)
{
    vec4 verdict = texelFetch(u_verdict, texel, 0);
    if (verdict.w < 0.0 || verdict.z == 0.0) {
        return false;
    }
    float x[8];
    read_candidate_position(texel, x);
    write_best(x);
    o_fitness = verdict.x;
    return true;
}
