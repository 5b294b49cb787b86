/* Second differences along lines of an image, which tell its noise (vision/photometric/image_noise.py). */
#include "fit.h"

#include <stdlib.h>

/* Lines and columns between places at least, and places in a large image: their median is good to half a per cent. Every
 * fourth place has counters of its own, so that no addition waits for that of the place before. */
enum { STEP = 4, PLACES = 1 << 15, LEVELS = 1021, TURNS = 4 };

/* Count |I(u - 1) - 2 I(u) + I(u + 1)| of every fourth column, where I(u) is above `darkest` and below `brightest`.
 * Of small images every fourth line is read, of large ones as many as have `PLACES`.
 *
 * counts (1021,) is the result: the number of places with each difference, 0 to 1020. Returns 0 or an error. */
int32_t count_second_differences(const uint8_t *image, int64_t height, int64_t width, int32_t darkest,
                                 int32_t brightest, int64_t *counts) {
    if (height < 0 || width < 0) return FIT_INVALID_SIZE;
    int64_t own[TURNS][LEVELS] = {{0}};
    const int64_t enough = height * width / (STEP * PLACES), lines = enough > STEP ? enough : STEP;
    for (int64_t v = 0; v < height; v += lines) {
        const uint8_t *line = image + v * width;
        for (int64_t u = 1; u + 1 < width; u += STEP) {
            const int32_t here = line[u];
            if (here > darkest && here < brightest) own[u / STEP % TURNS][abs(line[u - 1] - 2 * here + line[u + 1])]++;
        }
    }
    for (int i = 0; i < LEVELS; i++) counts[i] = own[0][i] + own[1][i] + own[2][i] + own[3][i];
    return 0;
}
