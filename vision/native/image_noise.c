/* Second differences along lines of an image, which tell its noise (vision/photometric/image_noise.py). */
#include "fit.h"

#include <stdlib.h>

/* Lines and columns between places at least, and places in a large image: their median is good to half a per cent. Every
 * fourth place has counters of its own, so that no addition waits for that of the place before. */
enum { STEP = 4, PLACES = 1 << 15, LEVELS = 1021, NOT_COUNTED = LEVELS, TURNS = 4, CHUNK = 256 };

/* Compute |I(u - 1) - 2 I(u) + I(u + 1)| of `count` places, of which the first is at `line`. */
static void second_differences(const uint8_t *restrict line, int64_t count, int32_t darkest, int32_t brightest,
                               uint16_t *restrict differences) {
    for (int64_t i = 0; i < count; i++, line += STEP) {
        const int32_t here = line[1], difference = abs(line[0] - 2 * here + line[2]);
        differences[i] = (uint16_t)(here > darkest && here < brightest ? difference : NOT_COUNTED);
    }
}

/* Count |I(u - 1) - 2 I(u) + I(u + 1)| of every fourth column, where I(u) is above `darkest` and below `brightest`.
 * Of small images every fourth line is read, of large ones as many as have `PLACES`.
 *
 * counts (1021,) is the result: the number of places with each difference, 0 to 1020. Returns 0 or an error. */
int32_t count_second_differences(const uint8_t *image, int64_t height, int64_t width, int32_t darkest,
                                 int32_t brightest, int64_t *counts) {
    if (height < 0 || width < 0) return FIT_INVALID_SIZE;
    int32_t own[TURNS][LEVELS + 1] = {{0}};
    const int64_t enough = height * width / (STEP * PLACES), lines = enough > STEP ? enough : STEP, places = (width + 1) / STEP;
    for (int64_t v = 0; v < height; v += lines)
        for (int64_t first = 0; first < places; first += CHUNK) {
            uint16_t differences[CHUNK];
            const int64_t rest = places - first, count = rest < CHUNK ? rest : CHUNK;
            second_differences(image + v * width + STEP * first, count, darkest, brightest, differences);
            for (int64_t i = 0; i < count; i++) own[i % TURNS][differences[i]]++;
        }
    for (int i = 0; i < LEVELS; i++) counts[i] = (int64_t)own[0][i] + own[1][i] + own[2][i] + own[3][i];
    return 0;
}
