// Compute stand-ins for the fragment outputs: plain variables that the entry stores once the kernel has run.
// OUTPUT_n and OUTPUT_n_TYPE are defined by the pass, in the order of its outputs.

#ifdef OUTPUT_0
OUTPUT_0_TYPE OUTPUT_0;
#endif
#ifdef OUTPUT_1
OUTPUT_1_TYPE OUTPUT_1;
#endif
#ifdef OUTPUT_2
OUTPUT_2_TYPE OUTPUT_2;
#endif
#ifdef OUTPUT_3
OUTPUT_3_TYPE OUTPUT_3;
#endif
#ifdef OUTPUT_4
OUTPUT_4_TYPE OUTPUT_4;
#endif
#ifdef OUTPUT_5
OUTPUT_5_TYPE OUTPUT_5;
#endif
