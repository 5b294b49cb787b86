/* Columns of the model under blur that differs much along its directions: at a steep tilt, or by a streak.
 *
 * The blur is any Gaussian, of variances σ_x² and σ_y² along the marker's axes and correlation ρ. Along the axes it
 * separates; the correlation follows by Mehler's series,
 *
 *     G = Σ_n ρⁿ / n! (σ_x σ_y ∂_x ∂_y)ⁿ F,
 *
 * with F the marker under the same variances without correlation. Terms from n = 1 on are zero but at cells' corners. The
 * series is summed up to n = 4 in the marker, and up to n = 1 in its slopes, which decide how fast a fit converges, not
 * where to. At a correlation of 0.8, that of a tilt of 70 degrees at its worst, the next term is 0.4 % of the contrast at
 * corners, and at 0.6, that of 60 degrees, 0.1 %.
 *
 * Seen in perspective, with the image p = A z / w, w = 1 + q·z, a pixel's own blur is w² (1 + z qᵀ) Σ (1 + q zᵀ) where Σ is
 * that at the marker's centre: the inverse of p's derivative is w (1 + z qᵀ) A⁻¹.
 */
#include "columns.h"

/* Blur of a marker at its centre, by how much it changes with its logarithm, and its growth along the keystone q. */
typedef struct {
    float xx, yy, xy, by_xx, by_yy, by_xy;
    float grow_x, grow_y, grow; /* components of Σ q, and q·Σ q */
} CentreBlur;

static CentreBlur centre_blur(const Marker *marker, const double *blur) {
    CentreBlur made = {.xx = (float)blur[0], .yy = (float)blur[1], .xy = (float)blur[2],
                       .by_xx = 0.5f * (float)blur[3], .by_yy = 0.5f * (float)blur[4], .by_xy = (float)blur[5]};
    const float qx = (float)marker->keystone.re, qy = (float)marker->keystone.im;
    made.grow_x = made.xx * qx + made.xy * qy;
    made.grow_y = made.xy * qx + made.yy * qy;
    made.grow = qx * made.grow_x + qy * made.grow_y;
    return made;
}

/* Standard deviations of the blur along x and y at pixels, their inverses, and the correlation. */
typedef struct { Floats sigma_x, sigma_y, x_rate, y_rate, correlation; } PixelBlur;

INLINE PixelBlur blur_at(const CentreBlur *blur, Floats x, Floats y, Floats w_square) {
    PixelBlur own;
    own.sigma_x = square_root(w_square * (blur->xx + 2.0f * x * blur->grow_x + x * x * blur->grow));
    own.sigma_y = square_root(w_square * (blur->yy + 2.0f * y * blur->grow_y + y * y * blur->grow));
    own.x_rate = 1.0f / own.sigma_x;
    own.y_rate = 1.0f / own.sigma_y;
    const Floats covariance =
        w_square * (blur->xy + x * blur->grow_y + y * blur->grow_x + x * y * blur->grow);
    own.correlation = covariance * own.x_rate * own.y_rate;
    return own;
}

/* Return w² of the perspective at pixels, px from the centre: (1 / (1 - Re(h̄ p)))². */
INLINE Floats w_square_at(const Marker *marker, const Part *part) {
    EightInts u[LANES / EIGHT], v[LANES / EIGHT];
    EightFloats squares[LANES / EIGHT];
    memcpy(u, &part->u, sizeof u);
    memcpy(v, &part->v, sizeof v);
    for (int i = 0; i < LANES / EIGHT; i++) {
        const Doubles right = __builtin_convertvector(u[i], Doubles) - marker->center.re;
        const Doubles below = __builtin_convertvector(v[i], Doubles) - marker->center.im;
        const Doubles w = 1 / (1 - (marker->perspective.re * right + marker->perspective.im * below));
        squares[i] = __builtin_convertvector(w * w, EightFloats);
    }
    Floats all_squares;
    memcpy(&all_squares, squares, sizeof all_squares);
    return all_squares;
}

/* G, σ_x G_x, σ_y G_y, σ_x² G_xx, σ_x σ_y G_xy and σ_y² G_yy. */
typedef struct { Floats g, x, y, xx, xy, yy; } Blurred;

/* Return the sums over rows and columns of cells, with f[i][j] the i-th derivative along x and the j-th along y. */
INLINE Blurred blurred_at(int count, const CellBits *bits, const Edges *across, const Edges *down, Floats rho) {
    enum { X = MAX_ORDERS };
    Floats above[X], here[X], f[X][X];
    sum_row(count, X, cells_of(bits, across, down, 0), across, above);
    for (int i = 0; i < X; i++)
        for (int j = 0; j < X; j++) f[i][j] = j == 0 ? above[i] : (Floats){0};
    for (int e = 0; e < count; e++) {
        sum_row(count, X, cells_of(bits, across, down, e + 1), across, here);
        for (int i = 0; i < X; i++) {
            const Floats change = here[i] - above[i];
            for (int j = 0; j < X; j++)
                if (j < 3 || i == j || (i == 1 && j == 3)) f[i][j] += down->orders[j][e] * change;
            above[i] = here[i];
        }
    }
    const Floats square = rho * rho, fourth = (1.0f / 24.0f) * f[4][4], third = (1.0f / 6.0f) * f[3][3];
    return (Blurred){
        .g = f[0][0] + rho * f[1][1] + square * (0.5f * f[2][2] + rho * (third + rho * fourth)),
        .x = f[1][0] + rho * f[2][1],
        .y = f[0][1] + rho * f[1][2],
        .xx = f[2][0] + rho * f[3][1],
        .xy = f[1][1] + rho * f[2][2],
        .yy = f[0][2] + rho * f[1][3],
    };
}

/* Return the sums of a marker without a card, with those of the ground `beyond` its border, of the given level. */
INLINE Blurred without_card(const Blurred *sums, const Blurred *beyond, float level) {
    return (Blurred){sums->g - level * beyond->g,   sums->x - level * beyond->x,   sums->y - level * beyond->y,
                     sums->xx - level * beyond->xx, sums->xy - level * beyond->xy, sums->yy - level * beyond->yy};
}

/* Return the level and its derivatives, and write T_xx, T_xy and T_yy times the weights. */
INLINE Shown shown_of(const Blurred *sums, const CentreBlur *blur, const PixelBlur *own, Floats w_square, Ground ground,
                      Ints within, float *bends) {
    const Floats xx = -sums->xx * own->x_rate * own->x_rate, xy = -sums->xy * own->x_rate * own->y_rate,
                 yy = -sums->yy * own->y_rate * own->y_rate;
    const Floats weight = choose(within, ground.weight, (Floats){0});
    store(xx * weight, bends);
    store(xy * weight, bends + BLOCK_PX);
    store(yy * weight, bends + 2 * BLOCK_PX);
    const Floats log_blur = w_square * (blur->by_xx * xx + blur->by_yy * yy + blur->by_xy * xy);
    return (Shown){1.0f - sums->g, -sums->x * own->x_rate * ground.weight, -sums->y * own->y_rate * ground.weight,
                   log_blur, ground};
}

/* Fill in the blocks of one marker; `count` edges along each axis, of which all are if `is_all`. */
INLINE void fill_marker(int count, int is_all, const Scene *scene, const MarkerBlocks *given, int64_t k,
                        const CentreBlur *blur, float *bends) {
    const Marker *marker = scene->markers + k;
    const int64_t sides = scene->n + 2;
    const CellBits bits = bits_of(scene->cells + k * sides * sides, scene->n), outside = ground_bits(scene->n);
    const float n = (float)scene->n, half = n / 2, half_card = (float)marker->half_card;
    Edges across, down;
    for (int64_t at = given->bounds[k] * BLOCK_PX; at < given->bounds[k + 1] * BLOCK_PX; at += LANES) {
        const Part part = part_at(scene, given, k, at / BLOCK_PX, at % BLOCK_PX);
        const Floats x = part.x, y = part.y, w_square = w_square_at(marker, &part);
        const PixelBlur own = blur_at(blur, x, y, w_square);
        compute_edges(count, is_all, MAX_ORDERS, scene->n, x * n + half, own.x_rate / n, &across);
        compute_edges(count, is_all, MAX_ORDERS, scene->n, y * n + half, own.y_rate / n, &down);
        Blurred sums = blurred_at(count, &bits, &across, &down, own.correlation);
        Ground ground = {{0}, all(1.0f)};
        if (marker->is_bare) {
            const Blurred beyond = blurred_at(count, &outside, &across, &down, own.correlation);
            ground = weighted_ground(beyond.g, scene->texture_square);
            sums = without_card(&sums, &beyond, (float)marker->ground_level);
        } else if (marker->half_card < INFINITY)
            ground = ground_at(x, y, half_card, own.x_rate, own.y_rate, scene->texture_square);
        float *const own_bends = bends + at / BLOCK_PX * (3 * BLOCK_PX) + at % BLOCK_PX;
        const Shown shown = shown_of(&sums, blur, &own, w_square, ground, part.within, own_bends);
        write_columns(&shown, &part, marker, given->columns);
    }
}

/* Return the largest reach of the blur at a marker's pixels, in cells, or more. It is that of the corners around them: w²
 * and, along either axis, the variances are convex. */
static float reach_of(const Scene *scene, const Marker *marker, const CentreBlur *blur) {
    float w_square = 0, xx = 0, yy = 0;
    for (int corner = 0; corner < 4; corner++) {
        const float x = corner & 1 ? (float)marker->limit : -(float)marker->limit;
        const float y = corner & 2 ? (float)marker->limit : -(float)marker->limit;
        const float w = 1.0f + (float)marker->keystone.re * x + (float)marker->keystone.im * y;
        w_square = fmaxf(w_square, w * w);
        xx = fmaxf(xx, blur->xx + 2.0f * x * blur->grow_x + x * x * blur->grow);
        yy = fmaxf(yy, blur->yy + 2.0f * y * blur->grow_y + y * y * blur->grow);
    }
    return REACH_SIGMAS * (float)scene->n * sqrtf(w_square * fmaxf(xx, yy));
}

/* Fill in the weighted columns as `fill_round`, and bends (blocks, 3, BLOCK_PX): T_xx, T_xy and T_yy, weighted.
 *
 * Of the markers, sigma, anisotropy and the stretches are not used. blurs (count, 6) are the variances along x and y and
 * the covariance of the blur, in sides squared, and by how much each of them changes with the logarithm of the blur. */
int32_t fill_elliptic(const Scene *scene, const MarkerBlocks *given, const double *blurs, float *bends) {
    if (!are_valid(scene, given)) return FIT_INVALID_SIZE;
    for (int64_t k = 0; k < given->count; k++) {
        const CentreBlur blur = centre_blur(scene->markers + k, blurs + 6 * k);
        const float reach = reach_of(scene, scene->markers + k, &blur);
        if (reach <= 1) fill_marker(2, 0, scene, given, k, &blur, bends);
        else if (reach <= 2) fill_marker(4, 0, scene, given, k, &blur, bends);
        else if (reach <= 3) fill_marker(6, 0, scene, given, k, &blur, bends);
        else fill_marker(scene->n + 1, 1, scene, given, k, &blur, bends);
    }
    return 0;
}
