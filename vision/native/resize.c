/* Images shrunk by means over blocks, which equal cv2.resize on x86-64. */
#include "search.h"

enum { MAX_BLOCK_PX = 256 };

/* Adding and subtracting this rounds a number of up to 2^22 to a whole one, halves to even ones. */
static const float ROUNDING = 12582912.0f;

/* Write the means over `side` columns, from sums over as many rows; the callers pass a constant where it is usual. */
static inline __attribute__((always_inline)) void mean_blocks(const uint16_t *restrict sums, int32_t columns, int32_t side,
                                                              uint8_t *restrict means) {
    const float share = 1.0f / (float)(side * side);
    for (int32_t column = 0; column < columns; column++) {
        int32_t sum = 0;
        for (int32_t k = 0; k < side; k++) sum += sums[column * side + k];
        means[column] = (uint8_t)(int32_t)((float)sum * share + ROUNDING - ROUNDING);
    }
}

/* Two by two pixels: halves are rounded upwards. */
static void mean_pairs(const uint16_t *restrict sums, int32_t columns, uint8_t *restrict means) {
    for (int32_t column = 0; column < columns; column++)
        means[column] = (uint8_t)((sums[2 * column] + sums[2 * column + 1] + 2) >> 2);
}

/* Write the rounded means over blocks of side x side pixels (height / side, width / side).
 *
 * Pixels beyond the last whole block are ignored. sums (width,) is for work. Returns 0 or an error. */
int32_t block_means(const uint8_t *image, int32_t width, int32_t height, int32_t side, uint16_t *restrict sums,
                    uint8_t *means) {
    if (side < 2 || side > MAX_BLOCK_PX || width < side || height < side) return INVALID_SIZE;
    const int32_t columns = width / side, rows = height / side, used = columns * side;
    for (int32_t row = 0; row < rows; row++, means += columns) {
        const uint8_t *line = image + (ptrdiff_t)row * side * width;
        for (int32_t x = 0; x < used; x++) sums[x] = (uint16_t)(line[x] + line[x + width]);
        for (int32_t k = 2; k < side; k++) {
            line = image + ((ptrdiff_t)row * side + k) * width;
            for (int32_t x = 0; x < used; x++) sums[x] = (uint16_t)(sums[x] + line[x]);
        }
        if (side == 2) mean_pairs(sums, columns, means);
        else if (side == 4) mean_blocks(sums, columns, 4, means);
        else mean_blocks(sums, columns, side, means);
    }
    return 0;
}
