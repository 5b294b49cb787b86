/* Grids of grey cells.
 *
 * In a grid's coordinates (column x, row y, in cells) its light is a sum of steps at the lines of the grid. A pixel
 * receives
 *
 *     F = Σ_j Σ_k T_jk S_j(y) S_k(x),    S_k(x) = S((x - k) s_x),
 *
 * with s_x the size of a cell in σ. T_00 is the level of a cell, T_0k and T_j0 are the steps from cell to cell along x
 * and y, and T_jk are the steps of those steps. A is the same sum for a grid of ones. A line farther than `felt` counts
 * as infinitely far.
 *
 * Where lines meet at an angle with a cosine ρ, the two factors are correlated. By Plackett's identity (1954) a corner
 * then adds
 *
 *     ∫_0^ρ φ_r(y_j, x_k) dr ≈ ρ φ_{ρ/2}(y_j, x_k),
 *
 * with φ_r the binormal density of correlation r. For |ρ| above `slanted` Gauss's rule with two nodes replaces the
 * midpoint rule. For a narrow lens the joint fourth cumulants of the pixel's square add Edgeworth terms.
 */
#include "render.h"

#include <math.h>
#include <string.h>

/* Lines of constant x, or of constant y, that LANES pixels feel. */
typedef struct {
    int32_t first[LANES], end[LANES]; /* first line that a pixel feels, and the one after the last; of 0..cells */
    int32_t most;                     /* largest number of lines that a pixel feels */
    float offset[LANES];              /* distance from the first line, cells */
    float inside[LANES];              /* share of the pixel between the first and the last line of the grid */
    float distance[MAX_CELLS + 1][LANES]; /* of the lines, σ, within the table's reach */
    float spread[MAX_CELLS + 1][LANES];   /* S at the felt lines, otherwise 0 */
} Lines;

/* Find the lines that pixels feel. */
static void feel(const double at[LANES], const float sharpness[LANES], const int32_t is_seen[LANES], int32_t cells,
                 float felt, Lines *restrict lines) {
    const float most_low = (float)cells + 0.5f, most_high = (float)cells + 1;
    for (int i = 0; i < LANES; i++) {
        const float near = (float)at[i], reach = felt / sharpness[i];
        const float low = clamped_float(near - reach, 0, most_low), high = clamped_float(near + reach + 1, 0, most_high);
        const int32_t below = (int32_t)low, first = below + (below < low), end = (int32_t)high;
        lines->first[i] = first * is_seen[i];
        lines->end[i] = end * is_seen[i];
        lines->offset[i] = (float)(at[i] - lines->first[i]);
    }
    int32_t most = 0;
    for (int i = 0; i < LANES; i++) {
        const int32_t count = lines->end[i] - lines->first[i];
        most = count > most ? count : most;
    }
    lines->most = most;
}

/* Compute S at the felt lines, and the share of each pixel between the first and the last line of the grid. */
static void spread_light(const float sharpness[LANES], const EdgeSpread *spread, int32_t direction, int32_t cells,
                         Lines *restrict lines) {
    const float *restrict table = spread->table + (ptrdiff_t)direction * spread->samples;
    const float half = (float)(spread->samples / 2), reach = (float)spread->reach, per_sigma = (half - 1) / reach;
    for (int i = 0; i < LANES; i++) lines->inside[i] = (lines->first[i] > 0) & (lines->first[i] <= cells);
    for (int32_t number = 0; number < lines->most; number++) {
        float *restrict felt = lines->spread[number], *restrict at = lines->distance[number];
        for (int i = 0; i < LANES; i++) {
            at[i] = clamped_float((lines->offset[i] - (float)number) * sharpness[i], -reach, reach);
            const float value = table[(int32_t)(at[i] * per_sigma + (half + 0.5f))];
            const int32_t line = lines->first[i] + number;
            felt[i] = value * (float)(line < lines->end[i]);
            lines->inside[i] += felt[i] * (float)((line == 0) - (line == cells));
        }
    }
}

static int32_t least(int32_t a, int32_t b) { return a < b ? a : b; }

/* Compute Σ_k T_k S_k of one row of cells for each pixel. `row` is where its row begins in the framed grid. */
static void sum_row(const float *restrict grid, const int32_t row[LANES], const Lines *restrict lines, int32_t cells,
                    float total[restrict LANES]) {
    float before[LANES];
    for (int i = 0; i < LANES; i++) total[i] = before[i] = grid[row[i] + lines->first[i]];
    for (int32_t number = 0; number < lines->most; number++) {
        const float *restrict spread = lines->spread[number];
        for (int i = 0; i < LANES; i++) {
            const float after = grid[row[i] + least(lines->first[i] + number, cells) + 1];
            total[i] += (after - before[i]) * spread[i];
            before[i] = after;
        }
    }
}

/* Compute F as if lines met at right angles: Σ_j (Σ_k T_jk S_k) S_j. */
static void sum_grid(const float *grid, const Lines *lines_x, const Lines *lines_y, int32_t cells,
                     float total[restrict LANES]) {
    float before[LANES], after[LANES];
    int32_t row[LANES];
    for (int i = 0; i < LANES; i++) row[i] = lines_y->first[i] * (cells + 2);
    sum_row(grid, row, lines_x, cells, total);
    memcpy(before, total, sizeof before);
    for (int32_t number = 0; number < lines_y->most; number++) {
        const float *restrict spread = lines_y->spread[number];
        for (int i = 0; i < LANES; i++) row[i] = (least(lines_y->first[i] + number, cells) + 1) * (cells + 2);
        sum_row(grid, row, lines_x, cells, after);
        for (int i = 0; i < LANES; i++) total[i] += (after[i] - before[i]) * spread[i];
        memcpy(before, after, sizeof before);
    }
}

/* Return e^x of -80 <= x <= 0. Its relative error is below 3e-7: x = n ln 2 + f, and the Taylor polynomial of degree 6
 * of |f| <= ln 2 / 2 is exact to 1.2e-7. */
static inline float exp_negative(float x) {
    const float LOG2_E = 1.44269504f, LN_2_HIGH = 0.693359375f, LN_2_LOW = -2.12194440e-4f;
    const int32_t whole = (int32_t)(x * LOG2_E - 0.5f);
    const float n = (float)whole, f = (x - n * LN_2_HIGH) - n * LN_2_LOW;
    const float polynomial =
        1 + f * (1 + f * (1.0f / 2 + f * (1.0f / 6 + f * (1.0f / 24 + f * (1.0f / 120 + f * (1.0f / 720))))));
    const union { int32_t bits; float value; } power = {(whole + 127) * (1 << 23)};
    return polynomial * power.value;
}

/* Binormal densities of LANES pixels with correlations r: factor e^(scale (x² + y² - 2 r x y)). */
typedef struct { float r[LANES], scale[LANES], factor[LANES]; } Binormal;

static void begin_binormal(const float cosine[LANES], const float share[LANES], Binormal *restrict binormal) {
    const float TWO_PI = 6.28318531f;
    for (int i = 0; i < LANES; i++) {
        const float r = share[i] * cosine[i], rest = 1 - r * r;
        binormal->r[i] = r;
        binormal->scale[i] = -1 / (2 * rest);
        binormal->factor[i] = 1 / (TWO_PI * sqrtf(rest));
    }
}

static inline float density(const Binormal *binormal, int i, float x, float y) {
    const float square = x * x + y * y - 2 * binormal->r[i] * x * y;
    return binormal->factor[i] * exp_negative(square * binormal->scale[i]);
}

/* Correlation of the two axes at LANES pixels, and the cumulants κ_22 / 4, κ_31 / 6, κ_13 / 6 of the pixel's square
 * across lines of x and of y, over σ⁴. */
typedef struct {
    Binormal nodes[2];
    int has_two_nodes;
    float cosine[LANES], two_nodes[LANES], is_used[LANES];
    float even, odd_x, odd_y;
} Corner;

/* Prepare the corners of LANES pixels. Return 0 if no pixel needs them. */
static int begin_corner(const Run *run, const Places *places, const EdgeSpread *spread, Corner *restrict corner) {
    const int is_boxy = spread->kurtosis < -spread->boxy;
    const float square = (float)spread->square, slanted = (float)spread->slanted;
    int used = 0, two_nodes = 0;
    float shares[2][LANES];
    for (int i = 0; i < LANES; i++) {
        const float cosine = places->cosine[i], size = fabsf(cosine);
        const int is_used = places->is_seen[i] & (is_boxy | (size > square)), has_two = is_used & (size > slanted);
        corner->cosine[i] = size <= 1 ? cosine : 0; /* also not NaN, where an edge has no direction */
        corner->is_used[i] = (float)is_used;
        corner->two_nodes[i] = (float)has_two;
        shares[0][i] = has_two ? 0.211324865f : 0.5f; /* Gauss's nodes (1 ± 1/√3) / 2 */
        shares[1][i] = 0.788675135f;
        used |= is_used;
        two_nodes |= has_two;
    }
    if (!used) return 0;
    corner->has_two_nodes = two_nodes;
    begin_binormal(corner->cosine, shares[0], &corner->nodes[0]);
    begin_binormal(corner->cosine, shares[1], &corner->nodes[1]);
    const double *s = run->slopes, x = sqrt(s[0] * s[0] + s[1] * s[1]), y = sqrt(s[2] * s[2] + s[3] * s[3]);
    const double a = x > 0 ? s[0] / x : 0, b = x > 0 ? s[1] / x : 0, c = y > 0 ? s[2] / y : 0, d = y > 0 ? s[3] / y : 0;
    corner->even = (float)(spread->kurtosis / 4 * (a * a * c * c + b * b * d * d));
    corner->odd_x = (float)(spread->kurtosis / 6 * (a * a * a * c + b * b * b * d));
    corner->odd_y = (float)(spread->kurtosis / 6 * (a * c * c * c + b * d * d * d));
    return 1;
}

/* Compute the binormal density of LANES pixels at distances x and y, by one node or the mean of two. */
static void binormal_density(const Corner *restrict corner, const float x[restrict LANES],
                             const float y[restrict LANES], float joint[restrict LANES]) {
    for (int i = 0; i < LANES; i++) joint[i] = density(&corner->nodes[0], i, x[i], y[i]);
    if (!corner->has_two_nodes) return;
    for (int i = 0; i < LANES; i++) {
        const float second = density(&corner->nodes[1], i, x[i], y[i]);
        joint[i] = corner->two_nodes[i] > 0 ? (joint[i] + second) / 2 : joint[i];
    }
}

/* Add a corner's share of light and cover: that of the felt lines number k of x and j of y. */
static void add_corner(const Corner *restrict corner, const float *restrict grid, const Lines *restrict lines_x,
                       const Lines *restrict lines_y, int32_t k, int32_t j, int32_t cells,
                       float light[restrict LANES], float covered[restrict LANES]) {
    const float *restrict x = lines_x->distance[k], *restrict y = lines_y->distance[j];
    float joint[LANES];
    binormal_density(corner, x, y, joint);
    for (int i = 0; i < LANES; i++) {
        const float terms = corner->cosine[i] + corner->even * x[i] * y[i] + corner->odd_x * (x[i] * x[i] - 1) +
                            corner->odd_y * (y[i] * y[i] - 1);
        const int32_t line_x = lines_x->first[i] + k, line_y = lines_y->first[i] + j;
        const int is_felt = (line_x < lines_x->end[i]) & (line_y < lines_y->end[i]);
        const float more = joint[i] * terms * (corner->is_used[i] * (float)is_felt);
        const int32_t at = least(line_y, cells) * (cells + 2) + least(line_x, cells), below = at + cells + 2;
        const float sign_x = (float)((line_x == 0) - (line_x == cells));
        const float sign_y = (float)((line_y == 0) - (line_y == cells));
        light[i] += more * ((grid[below + 1] - grid[below]) - (grid[at + 1] - grid[at]));
        covered[i] += more * sign_x * sign_y;
    }
}

/* Compute F and A of a grid. `grid` has (cells + 2)² levels, with a border of zeros. */
static void cover_lattice(const Run *run, const Places *places, const EdgeSpread *spread, const float *grid,
                          int32_t cells, float light[LANES], float covered[LANES]) {
    Lines lines_x, lines_y;
    feel(places->x, places->sharp_x, places->is_seen, cells, (float)spread->felt, &lines_x);
    feel(places->y, places->sharp_y, places->is_seen, cells, (float)spread->felt, &lines_y);
    spread_light(places->sharp_x, spread, run->direction_x, cells, &lines_x);
    spread_light(places->sharp_y, spread, run->direction_y, cells, &lines_y);
    sum_grid(grid, &lines_x, &lines_y, cells, light);
    for (int i = 0; i < LANES; i++) covered[i] = lines_x.inside[i] * lines_y.inside[i];
    Corner corner;
    if (!lines_x.most || !lines_y.most || !begin_corner(run, places, spread, &corner)) return;
    for (int32_t j = 0; j < lines_y.most; j++)
        for (int32_t k = 0; k < lines_x.most; k++)
            add_corner(&corner, grid, &lines_x, &lines_y, k, j, cells, light, covered);
}

/* Draw grids of grey levels (count, cells + 2, cells + 2), each with a border of zeros. */
int32_t draw_lattices(const Canvas *canvas, const Shapes *shapes, const EdgeSpread *spread, const float *levels,
                      int32_t cells) {
    if (cells < 1 || cells > MAX_CELLS) return INVALID_CELLS;
    return draw_shapes(canvas, shapes, spread, levels, cells, (cells + 2) * (cells + 2), cover_lattice);
}
