/* Functions that every library has: the version of its sources, and the processor's instruction set. */
#include <stdint.h>

const char *sources_version(void);
int32_t processor_level(void);

/* Return the hash of the sources and flags that the library was built from. */
const char *sources_version(void) { return SKYHERD_SOURCES; }

/* Return the highest x86-64 level of the processor that a library is built for, 2 to 4; on others 0. */
int32_t processor_level(void) {
#if defined(__x86_64__)
    __builtin_cpu_init();
    const int three = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2");
    const int four = three && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
                     __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") &&
                     __builtin_cpu_supports("avx512vl");
    return four ? 4 : three ? 3 : 2;
#else
    return 0;
#endif
}
