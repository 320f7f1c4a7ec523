/*
 * The gearbox model as a plain scalar C program: the yardstick of the kernel's speed.
 *
 * Same equations, same RK4, same events and same samples as gear_dynamics_ros/physics/kernel, written the way C
 * is written: structures, ordinary control flow, no intrinsics. Works and losses, the list of impacts, and the
 * mesh impulse are the kernel's alone: here a step adds what RK4 misses of the surfaces, to sixth order, and is
 * halved for the damping of a contact as for any other. All values are SI; equation numbers are the paper's.
 */

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define PI 3.14159265358979323846
#define TWO_PI (2.0 * PI)
#define TURNS_PER_RADIAN (1.0 / TWO_PI)

enum { SERIES_TERMS = 9, CHANNELS = 28 };

static const double SERIES_REACH = 1.0 / 40.0; /* of tan^2(alpha0) */
static const double ARCTANGENT_REACH = 1e-2;
static const double ARCTANGENT_SERIES_REACH = 0.2;

static const double GAP_TOLERANCE = 1e-8; /* of the change of the value over the step */
static const double CLAMP_TOLERANCE = 1e-6;
enum { SEARCH_LIMIT = 30, STOPS_PER_STEP = 24 };
static const double GAP_FRACTION = 0.1;       /* of the step: shortest substep that a gap asks for */
static const double STIFFNESS_LIMIT = 0.25;   /* substep times damping rate of a contact */
static const double SUBSTEPS_LIMIT = 4096.0;
static const double SHORTEST_SUBSTEP = 1e-9;  /* of the step */

enum status { RUNNING, OVER_SPEED, NON_FINITE, CENTRES_PRESSED };

struct constants {
    int64_t kelvin, film, exact_geometry, contact_damping, nominal_phase, brake, governed;
    int64_t hunting; /* turns of gear 1 after which the same teeth meet again */
    int64_t steps_per_sample;
    double centre_distance, base_radius[2], per_radii;
    double tan2_alpha0, involute_alpha0, involute_series[SERIES_TERMS];
    double half_backlash, stiffness, damping, error_mean;
    double per_mass[2], per_inertia[2], per_mesh_mass, teeth1;
    double clearance[2], kelvin_stiffness[2], kelvin_damping[2], hertz[2], damping_factor[2];
    double per_oil_clearance[2], film_factor[2];
    double minimum_impact_speed, eccentricity_limit2;
    double load_viscous, governor_proportional, governor_integral, governor_limit, speed_limit, step;
};

/* Periodic excitations at one phase, with their derivatives by the mesh phase. */
enum {
    SURFACE, SURFACE_SLOPE, SURFACE_CURVATURE, STIFFNESS, STIFFNESS_SLOPE, ERROR, ERROR_SLOPE, ERROR_CURVATURE,
    EXCITATIONS
};

struct excitation {
    double sum[EXCITATIONS];
};

/* Trigonometric series over the hunting cycle: amplitudes of cosines, then of sines, a wave a row. */
struct waves {
    size_t count;
    double *order, *cosine, *sine;
    double (*of_cosine)[EXCITATIONS], (*of_sine)[EXCITATIONS];
};

/* Coordinates x1 y1 x2 y2 u theta1 and velocities vx1 vy1 vx2 vy2 omega1 omega2. */
enum { X1, Y1, X2, Y2, U, THETA1, FREEDOMS };
enum { OMEGA1 = 4, OMEGA2 };

struct state {
    double position[FREEDOMS];
    double velocity[FREEDOMS];
    double impulse; /* integral of the mesh force */
};

/* What is frozen within a substep. */
struct contacts {
    int flank; /* 1 drive flank, 0 apart, -1 back flank */
    bool mesh_clamped;
    bool touching[2], clamped[2], starved[2];
    double impact_speed[2], age[2];
};

/* Switching surfaces: a value is positive on the side its flag stands for. */
enum event {
    UPPER_GAP, LOWER_GAP, MESH_CLAMP, BEARING_GAP, BEARING_CLAMP = BEARING_GAP + 2,
    FILM_LIMIT = BEARING_CLAMP + 2, EVENTS = FILM_LIMIT + 2, NO_EVENT = -1
};

struct surfaces {
    double value[EVENTS];
    double rate[EVENTS];
};

struct bearing {
    double penetration, closing, damping;
    double contact_x, contact_y, film_x, film_y;
};

/* Everything evaluated at one state. */
struct point {
    double acceleration[FREEDOMS];
    double mesh_force, along_x, along_y, stiffness, surface, surface_rate;
    double q, q_rate, tan_alpha, half_backlash, load_torque;
    struct surfaces surfaces;
    struct bearing bearing[2];
};

/* The start or the end of a substep; the state is ahead of the excitations by lag rad of mesh phase. */
struct moment {
    struct state state;
    struct excitation excitation;
    struct point point;
    double lag;
};

struct counters {
    int64_t steps, events, capped, impacts, flank_changes;
};

struct gearbox {
    struct constants constants;
    struct waves waves;
    struct contacts contacts;
    double speed, load_torque, drive_torque, governor; /* set-point; torques; integral part of the governor */
    double nominal_turn, nominal_rest;                 /* of gear 1; what rounding took from it */
    int64_t turn, revolutions;                         /* modulo the hunting cycle; since the start */
    bool pressed;
    struct counters counters;
    struct moment moments[2], *here, *end;
};

/* Sum of all waves at turn, the fraction of the hunting cycle. */
static void excite(const struct waves *waves, double turn, struct excitation *excitation)
{
    const size_t count = waves->count;
    const double *restrict order = waves->order;
    double *restrict cosine = waves->cosine, *restrict sine = waves->sine;

    for (size_t j = 0; j < count; j++) {
        /* Taylor's polynomials of the half angle, |x| <= pi / 2. */
        double r = order[j] * turn;
        r -= (r + 6755399441055744.0) - 6755399441055744.0;
        const double x = PI * r, x2 = x * x;
        double s = 1.0 / 51090942171709440000.0;
        s = s * x2 - 1.0 / 121645100408832000.0;
        s = s * x2 + 1.0 / 355687428096000.0;
        s = s * x2 - 1.0 / 1307674368000.0;
        s = s * x2 + 1.0 / 6227020800.0;
        s = s * x2 - 1.0 / 39916800.0;
        s = s * x2 + 1.0 / 362880.0;
        s = s * x2 - 1.0 / 5040.0;
        s = s * x2 + 1.0 / 120.0;
        s = s * x2 - 1.0 / 6.0;
        s = x + x * x2 * s;
        double c = 1.0 / 2432902008176640000.0;
        c = c * x2 - 1.0 / 6402373705728000.0;
        c = c * x2 + 1.0 / 20922789888000.0;
        c = c * x2 - 1.0 / 87178291200.0;
        c = c * x2 + 1.0 / 479001600.0;
        c = c * x2 - 1.0 / 3628800.0;
        c = c * x2 + 1.0 / 40320.0;
        c = c * x2 - 1.0 / 720.0;
        c = c * x2 + 1.0 / 24.0;
        c = c * x2 - 0.5;
        c = c * x2 + 1.0;
        sine[j] = 2.0 * s * c;
        cosine[j] = 1.0 - 2.0 * s * s;
    }

    double sum[EXCITATIONS] = {0.0};
    for (size_t j = 0; j < count; j++) {
        const double *of_cosine = waves->of_cosine[j], *of_sine = waves->of_sine[j];
        const double c = cosine[j], s = sine[j];
        /* Unrolled early, gcc would gather eight waves into a vector rather than the eight columns at hand. */
#pragma GCC unroll 1
        for (size_t k = 0; k < EXCITATIONS; k++)
            sum[k] += c * of_cosine[k] + s * of_sine[k];
    }
    memcpy(excitation->sum, sum, sizeof sum);
}

/* Fraction of the hunting cycle, turn being what exceeds the whole turns of gear 1. */
static inline double cycle_fraction(const struct gearbox *g, double turn)
{
    return ((double)g->turn + turn) / (double)g->constants.hunting;
}

static inline double arctangent(double x)
{
    if (fabs(x) > ARCTANGENT_SERIES_REACH)
        return atan(x);
    const double x2 = x * x, x4 = x2 * x2;
    const double even =
        1.0 / 5.0 + x4 * (1.0 / 9.0 + x4 * (1.0 / 13.0 + x4 * (1.0 / 17.0 + x4 * (1.0 / 21.0))));
    const double odd =
        1.0 / 3.0 + x4 * (1.0 / 7.0 + x4 * (1.0 / 11.0 + x4 * (1.0 / 15.0 + x4 * (1.0 / 19.0))));
    return x - x * x2 * (odd - x2 * even);
}

/* Capone's short-bearing film (9)-(15): w shaft speed, e eccentricity and u velocity over the clearance. */
static inline void film_force(double coefficient, double w, double ex, double ey, double ux, double uy,
                              struct bearing *bearing)
{
    const double a = w * ex - 2.0 * uy, b = w * ey + 2.0 * ux;
    const double m = sqrt(a * a + b * b);
    if (m == 0.0) {
        bearing->film_x = bearing->film_y = 0.0;
        return;
    }
    const double inverse_m = 1.0 / m;
    const double cos_al = -a * inverse_m, sin_al = -b * inverse_m;
    const double inverse_root = 1.0 / sqrt(1.0 - (ex * ex + ey * ey));
    const double inverse_s = inverse_root * inverse_root;
    const double h = ey * cos_al - ex * sin_al;
    const double g = 2.0 * inverse_root * (0.5 * PI + arctangent(h * inverse_root));
    const double v = (2.0 + h * g) * inverse_s;
    const double c = ex * cos_al + ey * sin_al;
    const double s = c / (1.0 - c * c);
    const double f = -coefficient * m * inverse_s;
    bearing->film_x = f * (3.0 * ex * v - sin_al * g - 2.0 * cos_al * s);
    bearing->film_y = f * (3.0 * ey * v + cos_al * g - 2.0 * sin_al * s);
}

/* Contact (2)-(6) and film of the bearing of gear i (0 or 1), whose shaft turns at w. */
static inline void evaluate_bearing(const struct gearbox *g, int i, double w, const struct state *state,
                                    struct point *point)
{
    const struct constants *k = &g->constants;
    const struct contacts *contacts = &g->contacts;
    struct surfaces *surfaces = &point->surfaces;
    struct bearing *bearing = &point->bearing[i];
    const double x = state->position[2 * i], y = state->position[2 * i + 1];
    const double vx = state->velocity[2 * i], vy = state->velocity[2 * i + 1];

    const double d = sqrt(x * x + y * y);
    const double inverse_d = d > 0.0 ? 1.0 / d : 0.0;
    const double nx = d > 0.0 ? x * inverse_d : 1.0, ny = y * inverse_d;
    const double delta = d - k->clearance[i];
    const double closing = vx * nx + vy * ny;

    double force = 0.0, damping = 0.0, clamp = 1.0;
    if (contacts->touching[i]) {
        if (k->kelvin) {
            damping = k->kelvin_damping[i];
            force = clamp = k->kelvin_stiffness[i] * delta + damping * closing;
        } else {
            const double depth = delta > 0.0 ? delta : 0.0;
            const double elastic = k->hertz[i] * depth * sqrt(depth * inverse_d);
            const double factor = k->damping_factor[i] / contacts->impact_speed[i];
            clamp = 1.0 + factor * closing;
            damping = elastic * factor;
            force = elastic * clamp;
        }
        if (contacts->clamped[i]) {
            force = 0.0;
            clamp = -clamp;
        }
    }

    double margin = 1.0, margin_rate = 0.0;
    bearing->film_x = bearing->film_y = 0.0;
    if (k->film) {
        const double per_c = k->per_oil_clearance[i];
        const double relative = d * per_c, eps2 = relative * relative;
        /* Before the event is located a trial may overshoot the limit, yet never the wall. */
        double bound2 = 0.5 * (1.0 + k->eccentricity_limit2);
        double ex = x * per_c, ey = y * per_c;
        margin = k->eccentricity_limit2 - eps2;
        margin_rate = -2.0 * relative * closing * per_c;
        if (contacts->starved[i]) {
            bound2 = k->eccentricity_limit2;
            margin = -margin;
            margin_rate = -margin_rate;
        }
        if (contacts->starved[i] || eps2 > bound2) {
            const double scale = sqrt(bound2 / eps2);
            ex *= scale;
            ey *= scale;
        }
        film_force(k->film_factor[i], w, ex, ey, vx * per_c, vy * per_c, bearing);
    }

    bearing->penetration = delta;
    bearing->closing = closing;
    bearing->damping = damping;
    bearing->contact_x = -force * nx;
    bearing->contact_y = -force * ny;
    const double side = contacts->touching[i] ? 1.0 : -1.0;
    surfaces->value[BEARING_GAP + i] = side * delta;
    surfaces->rate[BEARING_GAP + i] = side * closing;
    surfaces->value[BEARING_CLAMP + i] = clamp;
    surfaces->value[FILM_LIMIT + i] = margin;
    surfaces->rate[FILM_LIMIT + i] = margin_rate;
}

/* Rate of the value that tells whether the contact of gear i pushes. */
static inline double bearing_clamp_rate(const struct gearbox *g, int i, const struct state *state,
                                        const struct point *point)
{
    const struct constants *k = &g->constants;
    if (!g->contacts.touching[i])
        return 0.0;
    const struct bearing *bearing = &point->bearing[i];
    const double *at = state->position + 2 * i, *speed = state->velocity + 2 * i;
    const double *acceleration = point->acceleration + 2 * i;
    const double inverse_d = 1.0 / (bearing->penetration + k->clearance[i]), closing = bearing->closing;
    const double closing_rate =
        (acceleration[0] * at[0] + acceleration[1] * at[1] + speed[0] * speed[0] + speed[1] * speed[1] -
         closing * closing) * inverse_d;
    const double rate = k->kelvin ? k->kelvin_stiffness[i] * closing + k->kelvin_damping[i] * closing_rate
                                  : k->damping_factor[i] / g->contacts.impact_speed[i] * closing_rate;
    return g->contacts.clamped[i] ? -rate : rate;
}

/* inv alpha - inv alpha0, where tan^2 alpha = tan^2 alpha0 + xi. */
static inline double involute_change(const struct constants *k, double xi, double tan_alpha)
{
    if (fabs(xi) >= SERIES_REACH * k->tan2_alpha0)
        return tan_alpha - atan(tan_alpha) - k->involute_alpha0;
    double sum = k->involute_series[SERIES_TERMS - 1];
    for (int i = SERIES_TERMS - 2; i >= 0; i--)
        sum = sum * xi + k->involute_series[i];
    return sum * xi;
}

/* Position angle beta of the line of centres. */
static inline double position_angle(double dx, double dy)
{
    const double slope = dy / dx;
    if (fabs(slope) >= ARCTANGENT_REACH)
        return atan2(dy, dx);
    const double s2 = slope * slope;
    return slope * (1.0 - s2 * (1.0 / 3.0 - s2 * (0.2 - s2 * (1.0 / 7.0 - s2 * (1.0 / 9.0)))));
}

/*
 * Accelerations and switching surfaces (21)-(32) at state, contacts frozen. Inlined by force: a stage of a step
 * wants the accelerations alone, and gcc finds the function too large to drop the rest by itself.
 */
__attribute__((always_inline)) static inline void dynamics(const struct gearbox *g, const struct state *state,
                                                           const double *excitation, double lag,
                                                           struct point *point)
{
    const struct constants *k = &g->constants;
    const struct contacts *contacts = &g->contacts;
    struct surfaces *surfaces = &point->surfaces;
    const double *position = state->position, *velocity = state->velocity;
    const double omega1 = velocity[OMEGA1], omega2 = velocity[OMEGA2];
    const double rb1 = k->base_radius[0], rb2 = k->base_radius[1], radii = rb1 + rb2;

    const double phi_rate = k->teeth1 * (k->nominal_phase ? g->speed : omega1);
    const double half = 0.5 * lag;
    const double z_slope = excitation[SURFACE_SLOPE] + lag * excitation[SURFACE_CURVATURE];
    const double z =
        excitation[SURFACE] + lag * (excitation[SURFACE_SLOPE] + half * excitation[SURFACE_CURVATURE]);
    const double e_slope = excitation[ERROR_SLOPE] + lag * excitation[ERROR_CURVATURE];
    const double e = k->error_mean + excitation[ERROR] +
                     lag * (excitation[ERROR_SLOPE] + half * excitation[ERROR_CURVATURE]);
    const double k1 = k->stiffness * (1.0 + excitation[STIFFNESS] + lag * excitation[STIFFNESS_SLOPE]);
    const double z_rate = phi_rate * z_slope, e_rate = phi_rate * e_slope;

    const double ux = position[X2] - position[X1], uy = position[Y2] - position[Y1];
    const double wx = velocity[X2] - velocity[X1], wy = velocity[Y2] - velocity[Y1];
    const double dx = k->centre_distance + ux;
    const double per_a = 1.0 / sqrt(dx * dx + uy * uy), per_a2 = per_a * per_a;
    const double xi = (ux * (2.0 * k->centre_distance + ux) + uy * uy) * (k->per_radii * k->per_radii);
    const double tan_alpha = sqrt(k->tan2_alpha0 + xi);
    const double cos_beta = dx * per_a, sin_beta = uy * per_a;
    const double cos_alpha = radii * per_a, sin_alpha = cos_alpha * tan_alpha;
    const double sin_gamma = sin_alpha * cos_beta - cos_alpha * sin_beta;
    const double cos_gamma = cos_alpha * cos_beta + sin_alpha * sin_beta;
    const double a_rate_over_a = (dx * wx + uy * wy) * per_a2;
    const double beta_rate = (dx * wy - uy * wx) * per_a2;
    const double b1 = radii * involute_change(k, xi, tan_alpha) + k->half_backlash - 0.5 * z;
    const double b1_rate = radii * tan_alpha * a_rate_over_a - 0.5 * z_rate;

    double q = position[U] - e;
    double q_rate = rb1 * omega1 - rb2 * omega2 - e_rate;
    if (k->exact_geometry) {
        q -= radii * position_angle(dx, uy);
        q_rate -= radii * beta_rate;
    } else {
        const double gamma_rate = a_rate_over_a / tan_alpha - beta_rate;
        q -= ux * sin_gamma + uy * cos_gamma;
        q_rate -= wx * sin_gamma + wy * cos_gamma + gamma_rate * (ux * cos_gamma - uy * sin_gamma);
    }

    double upper = b1 - q, upper_rate = b1_rate - q_rate;
    double lower = q + b1, lower_rate = q_rate + b1_rate;
    double along_x = sin_gamma, along_y = cos_gamma;
    double clamp = 1.0, clamp_side = 0.0, force = 0.0;
    const int flank = contacts->flank;
    if (flank > 0) {
        upper = -upper;
        upper_rate = -upper_rate;
        lower = 1.0;
        lower_rate = 0.0;
        force = k1 * upper;
    } else if (flank < 0) {
        force = k1 * lower;
        lower = -lower;
        lower_rate = -lower_rate;
        upper = 1.0;
        upper_rate = 0.0;
        if (k->exact_geometry) {
            along_x = -(sin_alpha * cos_beta + cos_alpha * sin_beta);
            along_y = cos_alpha * cos_beta - sin_alpha * sin_beta;
        }
    }
    if (!k->contact_damping) {
        force += k->damping * q_rate;
    } else if (flank != 0) {
        force += k->damping * (q_rate - flank * b1_rate);
        clamp_side = contacts->mesh_clamped ? -flank : flank;
        clamp = clamp_side * force;
        if (contacts->mesh_clamped) {
            force = 0.0;
        }
    }

    evaluate_bearing(g, 0, k->nominal_phase ? g->speed : omega1, state, point);
    evaluate_bearing(g, 1, k->nominal_phase ? -g->speed * rb1 / rb2 : -omega2, state, point);
    double load_torque = g->load_torque;
    if (k->brake)
        load_torque *= tanh(omega2);
    load_torque += k->load_viscous * omega2;

    const struct bearing *bearing1 = &point->bearing[0], *bearing2 = &point->bearing[1];
    point->acceleration[X1] = (bearing1->contact_x + bearing1->film_x - force * along_x) * k->per_mass[0];
    point->acceleration[Y1] = (bearing1->contact_y + bearing1->film_y - force * along_y) * k->per_mass[0];
    point->acceleration[X2] = (bearing2->contact_x + bearing2->film_x + force * along_x) * k->per_mass[1];
    point->acceleration[Y2] = (bearing2->contact_y + bearing2->film_y + force * along_y) * k->per_mass[1];
    point->acceleration[OMEGA1] = (g->drive_torque - force * rb1) * k->per_inertia[0];
    point->acceleration[OMEGA2] = (force * rb2 - load_torque) * k->per_inertia[1];
    double lean_x = along_x, lean_y = along_y;
    if (!k->exact_geometry) {
        lean_x += flank * sin_alpha * cos_beta;
        lean_y += flank * sin_alpha * sin_beta;
    }
    const double *acceleration = point->acceleration;
    const double phi_acceleration = k->nominal_phase ? 0.0 : k->teeth1 * acceleration[OMEGA1];
    const double z_acceleration =
        phi_rate * phi_rate * excitation[SURFACE_CURVATURE] + phi_acceleration * excitation[SURFACE_SLOPE];
    const double e_acceleration =
        phi_rate * phi_rate * excitation[ERROR_CURVATURE] + phi_acceleration * excitation[ERROR_SLOPE];
    const double approach_acceleration =
        rb1 * acceleration[OMEGA1] - rb2 * acceleration[OMEGA2] -
        lean_x * (acceleration[X2] - acceleration[X1]) - lean_y * (acceleration[Y2] - acceleration[Y1]) +
        0.5 * flank * z_acceleration - e_acceleration;
    const double push_rate = k->stiffness * phi_rate * excitation[STIFFNESS_SLOPE] * (q - flank * b1) +
                             k1 * (q_rate - flank * b1_rate) + k->damping * approach_acceleration;

    point->mesh_force = force;
    point->along_x = along_x;
    point->along_y = along_y;
    point->stiffness = k1;
    point->surface = z;
    point->surface_rate = z_rate;
    point->q = q;
    point->q_rate = q_rate;
    point->tan_alpha = tan_alpha;
    point->half_backlash = b1;
    point->load_torque = load_torque;
    surfaces->value[UPPER_GAP] = upper;
    surfaces->rate[UPPER_GAP] = upper_rate;
    surfaces->value[LOWER_GAP] = lower;
    surfaces->rate[LOWER_GAP] = lower_rate;
    surfaces->value[MESH_CLAMP] = clamp;
    surfaces->rate[MESH_CLAMP] = clamp_side * push_rate;
    for (int i = 0; i < 2; i++)
        surfaces->rate[BEARING_CLAMP + i] = bearing_clamp_rate(g, i, state, point);
}

static void evaluate(const struct gearbox *g, struct moment *moment)
{
    dynamics(g, &moment->state, moment->excitation.sum, moment->lag, &moment->point);
}

static inline void position_rates(const struct constants *k, const struct state *state, double *rate)
{
    const double *velocity = state->velocity;
    for (int i = 0; i < U; i++)
        rate[i] = velocity[i];
    rate[U] = k->base_radius[0] * velocity[OMEGA1] - k->base_radius[1] * velocity[OMEGA2];
    rate[THETA1] = velocity[OMEGA1];
}

static inline void move(const struct state *from, double h, const double *rate, const double *acceleration,
                        struct state *to)
{
    for (int i = 0; i < FREEDOMS; i++) {
        to->position[i] = from->position[i] + h * rate[i];
        to->velocity[i] = from->velocity[i] + h * acceleration[i];
    }
}

/*
 * What RK4 misses of the surfaces' share of the mesh force, whose shortest waves turn by a radian in a step:
 * the integral of dz/dt is the difference of z, that of z is taken to sixth order from values and rates.
 */
static inline void add_surface_impulse(const struct gearbox *g, double h, const struct point *middle,
                                       const struct point *late, const struct point *last, struct state *end)
{
    const struct constants *k = &g->constants;
    const struct point *first = &g->here->point;
    const double z0 = first->surface, s0 = first->surface_rate;
    const double z1 = last->surface, s1 = last->surface_rate;
    const double z_middle = 0.5 * (middle->surface + late->surface);
    const double s_middle = 0.5 * (middle->surface_rate + late->surface_rate);
    const double sixth = h / 6.0, rise = z1 - z0;
    const double integral = h * (7.0 * (z0 + z1) + 16.0 * z_middle) / 30.0 + h * h * (s0 - s1) / 60.0;
    const double damping = k->contact_damping ? k->damping : 0.0;
    const double grip = k->contact_damping && g->contacts.mesh_clamped ? 0.0 : 0.5 * g->contacts.flank;
    const double taken = sixth * (4.0 * (z_middle - z0) - h * (s0 + middle->surface_rate) + rise -
                                  h * late->surface_rate);
    const double impulse = grip * (damping * (rise - sixth * (s0 + 4.0 * s_middle + s1)) +
                                   late->stiffness * (integral - sixth * (z0 + 4.0 * z_middle + z1)) -
                                   damping * damping * k->per_mesh_mass * taken);
    const double shift = grip * damping * (integral - h * z0 - h * sixth * (s0 + 2.0 * s_middle));
    const double along[2] = {late->along_x, late->along_y};
    for (int i = 0; i < 2; i++) {
        const double side = i == 0 ? -1.0 : 1.0;
        for (int axis = 0; axis < 2; axis++) {
            end->position[2 * i + axis] += side * shift * k->per_mass[i] * along[axis];
            end->velocity[2 * i + axis] += side * impulse * k->per_mass[i] * along[axis];
        }
        const double turn = side * shift * k->base_radius[i] * k->per_inertia[i];
        end->velocity[OMEGA1 + i] += side * impulse * k->base_radius[i] * k->per_inertia[i];
        end->position[U] -= side * k->base_radius[i] * turn;
        if (i == 0)
            end->position[THETA1] += turn;
    }
    end->impulse += impulse;
}

/*
 * Classic RK4 over h from here to end, in Nystrom's form; nominal_turn is the nominal phase here. Excitations
 * are summed at two phases; the other stages lie within the square of the step of these and use the lag.
 */
static void try_step(struct gearbox *g, double nominal_turn, double h)
{
    const struct constants *k = &g->constants;
    const bool nominal = k->nominal_phase;
    const struct state *start = &g->here->state;
    const double *first = g->here->point.acceleration;
    struct moment *end = g->end;
    const double half = 0.5 * h, third = h / 3.0, sixth = h / 6.0;
    struct state stage;
    struct point middle, late, last;
    struct excitation halfway;
    double rate1[FREEDOMS], rate2[FREEDOMS], rate3[FREEDOMS];

    position_rates(k, start, rate1);
    move(start, half, rate1, first, &stage);
    double turn = nominal ? nominal_turn + half * g->speed * TURNS_PER_RADIAN
                          : stage.position[THETA1] * TURNS_PER_RADIAN;
    excite(&g->waves, cycle_fraction(g, turn), &halfway);
    dynamics(g, &stage, halfway.sum, 0.0, &middle);

    position_rates(k, &stage, rate2);
    move(start, half, rate2, middle.acceleration, &stage);
    const double late_lag = nominal ? 0.0 : k->teeth1 * half * (rate2[THETA1] - rate1[THETA1]);
    dynamics(g, &stage, halfway.sum, late_lag, &late);

    position_rates(k, &stage, rate3);
    move(start, h, rate3, late.acceleration, &stage);
    const double theta1 = stage.position[THETA1];
    turn = nominal ? nominal_turn + h * g->speed * TURNS_PER_RADIAN : theta1 * TURNS_PER_RADIAN;
    excite(&g->waves, cycle_fraction(g, turn), &end->excitation);
    dynamics(g, &stage, end->excitation.sum, 0.0, &last);

    /* Positions need k1 + k2 + k3 of the accelerations, speeds k1 + 2 k2 + 2 k3 + k4. */
    double drift[FREEDOMS];
    for (int i = 0; i < FREEDOMS; i++) {
        const double inner = middle.acceleration[i] + late.acceleration[i];
        drift[i] = first[i] + inner;
        end->state.velocity[i] =
            start->velocity[i] + sixth * (first[i] + last.acceleration[i]) + third * inner;
    }
    const double drift1 = drift[OMEGA1], drift2 = drift[OMEGA2];
    drift[U] = k->base_radius[0] * drift1 - k->base_radius[1] * drift2;
    drift[THETA1] = drift1;
    for (int i = 0; i < FREEDOMS; i++)
        end->state.position[i] = start->position[i] + h * (rate1[i] + sixth * drift[i]);
    end->state.impulse = start->impulse + sixth * (g->here->point.mesh_force + last.mesh_force) +
                         third * (middle.mesh_force + late.mesh_force);
    if (g->contacts.flank != 0)
        add_surface_impulse(g, h, &middle, &late, &last, &end->state);
    end->lag = nominal ? 0.0 : k->teeth1 * (end->state.position[THETA1] - theta1);
    evaluate(g, end);
}

/* The end of the trial becomes the state. */
static inline void accept(struct gearbox *g)
{
    struct moment *before = g->here;
    g->here = g->end;
    g->end = before;
}

/* Of a cubic over the unit bracket: v0 + s (r0 + s (c2 + s c3)). */
struct cubic {
    double v0, r0, c2, c3;
};

static struct cubic hermite(double v0, double r0, double v1, double r1)
{
    return (struct cubic){v0, r0, 3.0 * (v1 - v0) - 2.0 * r0 - r1, 2.0 * (v0 - v1) + r0 + r1};
}

static double cubic_value(const struct cubic *p, double s)
{
    return p->v0 + s * (p->r0 + s * (p->c2 + s * p->c3));
}

static double cubic_slope(const struct cubic *p, double s)
{
    return p->r0 + s * (2.0 * p->c2 + 3.0 * s * p->c3);
}

/* Root in (0, 1) of the cubic with values v0 > 0 > v1 and slopes r0, r1: Newton within a bracket. */
static double hermite_root(double v0, double r0, double v1, double r1)
{
    const struct cubic cubic = hermite(v0, r0, v1, r1);
    double low = 0.0, high = 1.0, s = v0 / (v0 - v1);
    for (int i = 0; i < 12; i++) {
        const double value = cubic_value(&cubic, s), slope = cubic_slope(&cubic, s);
        if (value > 0.0)
            low = s;
        else
            high = s;
        double following = slope != 0.0 ? s - value / slope : low;
        if (!(low < following && following < high))
            following = 0.5 * (low + high);
        if (fabs(following - s) < 1e-14)
            return following;
        s = following;
    }
    return s;
}

static double event_tolerance(int event)
{
    const bool clamp = event == MESH_CLAMP || event == BEARING_CLAMP || event == BEARING_CLAMP + 1;
    return clamp ? CLAMP_TOLERANCE : GAP_TOLERANCE;
}

/*
 * Whether a surface may have been crossed over the trial of length h: the cubic through its values and rates
 * stays positive where its values and those a third of the step along the tangents are.
 */
static inline bool is_eventful(const struct gearbox *g, double h)
{
    const struct surfaces *start = &g->here->point.surfaces, *end = &g->end->point.surfaces;
    const double third = h / 3.0;
    bool crossed = false;
    for (int event = 0; event < EVENTS; event++) {
        crossed |= end->value[event] < 0.0;
        crossed |= end->value[event] - third * end->rate[event] < 0.0;
        crossed |= start->value[event] + third * start->rate[event] < 0.0;
    }
    return crossed;
}

/* The event that seems to come first of those past their surface at the end. */
static int first_violated(const struct surfaces *start, const struct surfaces *end, double h)
{
    int first = NO_EVENT;
    double earliest = 2.0;
    for (int event = 0; event < EVENTS; event++) {
        const double v0 = start->value[event], v1 = end->value[event];
        if (v1 >= 0.0)
            continue;
        double at = 0.0;
        if (v0 > 0.0)
            at = hermite_root(v0, h * start->rate[event], v1, h * end->rate[event]);
        if (at < earliest) {
            first = event;
            earliest = at;
        }
    }
    return first;
}

/* Fraction of the step at which a surface seems to be crossed and crossed back, or 0. */
static double grazing_fraction(const struct surfaces *start, const struct surfaces *end, double h)
{
    for (int event = 0; event < EVENTS; event++) {
        const double v0 = start->value[event], r0 = h * start->rate[event];
        const double v1 = end->value[event], r1 = h * end->rate[event];
        if (v0 <= 0.0 || r0 >= 0.0 || r1 <= 0.0)
            continue;
        const struct cubic cubic = hermite(v0, r0, v1, r1);
        double low = 0.0, high = 1.0;
        for (int n = 0; n < 40; n++) {
            const double middle = 0.5 * (low + high);
            if (cubic_slope(&cubic, middle) < 0.0)
                low = middle;
            else
                high = middle;
        }
        if (cubic_value(&cubic, low) < 0.0)
            return low;
    }
    return 0.0;
}

/* Change what event stands for; a bearing contact that begins latches its speed. */
static void flip(struct gearbox *g, int event)
{
    struct contacts *contacts = &g->contacts;
    if (event <= LOWER_GAP) {
        const int side = event == UPPER_GAP ? 1 : -1;
        contacts->flank = contacts->flank == 0 ? side : 0;
        contacts->mesh_clamped = false;
        g->counters.flank_changes++;
    } else if (event == MESH_CLAMP) {
        contacts->mesh_clamped = !contacts->mesh_clamped;
    } else if (event < BEARING_CLAMP) {
        const int i = event - BEARING_GAP;
        contacts->clamped[i] = false;
        contacts->touching[i] = !contacts->touching[i];
        if (contacts->touching[i]) {
            const double closing = g->here->point.bearing[i].closing;
            const double slowest = g->constants.minimum_impact_speed;
            contacts->impact_speed[i] = closing > slowest ? closing : slowest;
            contacts->age[i] = 0.0;
            g->counters.impacts++;
        }
    } else if (event < FILM_LIMIT) {
        contacts->clamped[event - BEARING_CLAMP] ^= true;
    } else {
        contacts->starved[event - FILM_LIMIT] ^= true;
    }
    g->counters.events++;
}

/* Events that one stop decides together with event: without damping a gap and its clamp are one surface. */
static unsigned settled_with(int event)
{
    const unsigned self = 1u << event;
    if (event <= LOWER_GAP)
        return self | 1u << MESH_CLAMP;
    if (event == BEARING_GAP || event == BEARING_GAP + 1)
        return self | 1u << (event - BEARING_GAP + BEARING_CLAMP);
    return self;
}

/* An event past its surface and not in the set flipped: that may be short of its surface, on its way there. */
static int past_surface(const struct surfaces *surfaces, unsigned flipped)
{
    for (int event = 0; event < EVENTS; event++)
        if (surfaces->value[event] <= 0.0 && surfaces->rate[event] < 0.0 && !(flipped >> event & 1u))
            return event;
    return NO_EVENT;
}

/* Flip event here and, as events fall together, every other one that is past its surface. */
static void settle(struct gearbox *g, int event)
{
    unsigned flipped = settled_with(event);
    flip(g, event);
    for (int n = 0; n < EVENTS; n++) {
        evaluate(g, g->here);
        event = past_surface(&g->here->point.surfaces, flipped);
        if (event == NO_EVENT)
            return;
        flip(g, event);
        flipped |= settled_with(event);
    }
}

/* Another event that was crossed between low and the end of the trial, or NO_EVENT. */
static int crossed_earlier(const struct surfaces *low, const struct surfaces *end, int event)
{
    int earlier = NO_EVENT;
    for (int other = 0; other < EVENTS; other++) {
        const double v0 = low->value[other], v1 = end->value[other];
        if (other != event && v0 > 0.0 && v1 < -event_tolerance(other) * (v0 - v1))
            earlier = other;
    }
    return earlier;
}

/*
 * Shorten the step h until it ends on the first event; event is positive here and negative at the end on
 * entry. The next trial ends at the root of the cubic through both ends of the bracket; the late ones bisect.
 * A second event that comes earlier takes over.
 */
static int locate(struct gearbox *g, double nominal_turn, int event, double *h)
{
    const struct surfaces *end = &g->end->point.surfaces;
    struct surfaces low_surfaces = g->here->point.surfaces;
    const double whole = *h;
    double low = 0.0, high = whole;
    double v_high = end->value[event], r_high = end->rate[event];
    double tolerance = event_tolerance(event) * (low_surfaces.value[event] - v_high);

    for (int n = 0; n < SEARCH_LIMIT; n++) {
        const double width = high - low;
        double at = low + width * hermite_root(low_surfaces.value[event], width * low_surfaces.rate[event],
                                               v_high, width * r_high);
        if (!(low < at && at < high) || n >= SEARCH_LIMIT / 2)
            at = 0.5 * (low + high);
        try_step(g, nominal_turn, at);
        *h = at;

        const int earlier = crossed_earlier(&low_surfaces, end, event);
        if (earlier != NO_EVENT) {
            event = earlier;
            high = at;
            v_high = end->value[event];
            r_high = end->rate[event];
            tolerance = event_tolerance(event) * (low_surfaces.value[event] - v_high);
            continue;
        }
        const double value = end->value[event];
        if (fabs(value) <= tolerance || width <= 1e-12 * whole)
            return event;
        if (value < 0.0) {
            high = at;
            v_high = value;
            r_high = end->rate[event];
        } else {
            low = at;
            low_surfaces = *end;
        }
    }
    g->counters.capped++;
    return event;
}

/*
 * At most h, and less where a bearing contact begins or ends, where delta^1.5 is not smooth: no substep is
 * longer than the age of a contact, nor than half the time it seems to have left.
 */
static double longest_near_gap(const struct gearbox *g, double h)
{
    const double shortest = GAP_FRACTION * g->constants.step;
    if (g->constants.kelvin)
        return h;
    for (int i = 0; i < 2; i++) {
        if (!g->contacts.touching[i])
            continue;
        const struct bearing *bearing = &g->here->point.bearing[i];
        h = fmin(h, fmax(g->contacts.age[i], shortest));
        const double opening = -bearing->closing;
        if (2.0 * h * opening > bearing->penetration)
            h = fmax(0.5 * bearing->penetration / opening, fmin(h, shortest));
    }
    return h;
}

/* The step, halved until it bears the damping of the bearing contacts. */
static double longest_substep(struct gearbox *g)
{
    const struct constants *k = &g->constants;
    const struct bearing *bearing = g->here->point.bearing;
    const double rate1 = bearing[0].damping * k->per_mass[0], rate2 = bearing[1].damping * k->per_mass[1];
    const double rate = rate1 > rate2 ? rate1 : rate2, step = longest_near_gap(g, k->step);
    double substeps = 1.0;
    while (step * rate > STIFFNESS_LIMIT * substeps) {
        substeps *= 2.0;
        if (substeps == SUBSTEPS_LIMIT) {
            g->counters.capped++;
            break;
        }
    }
    return step / substeps;
}

static inline void accept_after(struct gearbox *g, double h)
{
    accept(g);
    g->contacts.age[0] += h;
    g->contacts.age[1] += h;
}

/* One step in substeps of at most longest, split at every event; a first trial of longest has been made. */
static void split_step(struct gearbox *g, double longest)
{
    const double step = g->constants.step;
    double nominal_turn = g->nominal_turn, done = 0.0, h = longest;
    int stops = 0;
    bool tried = true;

    for (;;) {
        if (!tried)
            try_step(g, nominal_turn, h);
        tried = false;

        int event = NO_EVENT;
        if (stops < STOPS_PER_STEP) {
            const struct surfaces *start = &g->here->point.surfaces, *end = &g->end->point.surfaces;
            event = first_violated(start, end, h);
            if (event == NO_EVENT) {
                const double fraction = grazing_fraction(start, end, h);
                if (fraction > SHORTEST_SUBSTEP) {
                    h *= fraction;
                    stops++;
                    continue;
                }
            } else if (start->value[event] > 0.0) {
                event = locate(g, nominal_turn, event, &h);
                stops++;
            } else if (h > SHORTEST_SUBSTEP * step) {
                /* Just flipped, yet past its surface at the end: look for a point before that. */
                h *= 0.5;
                continue;
            } else {
                g->counters.capped++;
                stops++;
            }
            if (stops == STOPS_PER_STEP)
                g->counters.capped++;
        }

        accept_after(g, h);
        done += h;
        nominal_turn += h * g->speed * TURNS_PER_RADIAN;
        if (event != NO_EVENT)
            settle(g, event);
        h = step - done;
        if (h <= SHORTEST_SUBSTEP * step)
            break;
        h = longest_near_gap(g, fmin(h, longest));
    }

    if (stops >= STOPS_PER_STEP) {
        int late = NO_EVENT;
        for (int event = 0; event < EVENTS; event++)
            if (g->here->point.surfaces.value[event] < 0.0)
                late = event;
        if (late != NO_EVENT)
            settle(g, late);
    }
}

static int64_t modulo(int64_t value, int64_t divisor)
{
    const int64_t rest = value % divisor;
    return rest < 0 ? rest + divisor : rest;
}

/* Bring theta1 back to one revolution and count it. */
static inline void wrap(struct gearbox *g)
{
    double *theta1 = &g->here->state.position[THETA1];
    int revolutions = 0;
    if (*theta1 >= TWO_PI)
        revolutions = 1;
    else if (*theta1 < 0.0)
        revolutions = -1;
    if (revolutions != 0) {
        *theta1 -= revolutions * TWO_PI;
        g->revolutions += revolutions;
        if (!g->constants.nominal_phase)
            g->turn = modulo(g->turn + revolutions, g->constants.hunting);
    }
}

/* One step of the nominal phase, without the drift of a plain sum (Kahan). */
static inline void advance_nominal(struct gearbox *g)
{
    const double increment = g->speed * g->constants.step * TURNS_PER_RADIAN - g->nominal_rest;
    double turn = g->nominal_turn + increment;
    g->nominal_rest = (turn - g->nominal_turn) - increment;
    if (turn >= 1.0) {
        turn -= 1.0;
        g->turn = modulo(g->turn + 1, g->constants.hunting);
    } else if (turn < 0.0) {
        turn += 1.0;
        g->turn = modulo(g->turn - 1, g->constants.hunting);
    }
    g->nominal_turn = turn;
}

static void make_step(struct gearbox *g)
{
    const double step = g->constants.step, longest = longest_substep(g);
    try_step(g, g->nominal_turn, longest);
    if (longest < step || is_eventful(g, step))
        split_step(g, longest);
    else
        accept_after(g, step);
    wrap(g);
    if (g->constants.nominal_phase)
        advance_nominal(g);
    g->counters.steps++;
    if (g->here->point.half_backlash <= 0.0)
        g->pressed = true;
}

/* PI governor, once a sample; its integral stands still while the torque is clipped. */
static void govern(struct gearbox *g)
{
    const struct constants *k = &g->constants;
    const double error = g->speed - g->here->state.velocity[OMEGA1], limit = k->governor_limit;
    const double wanted = k->governor_proportional * error + g->governor;
    g->drive_torque = fmin(fmax(wanted, -limit), limit);
    if (-limit <= wanted && wanted <= limit)
        g->governor += k->governor_integral * error * (k->step * (double)k->steps_per_sample);
}

/* Evaluate the state afresh; returns the turn of gear 1 that sets the phase. */
static double open_point(struct gearbox *g)
{
    struct moment *here = g->here;
    const double turn = g->constants.nominal_phase ? g->nominal_turn
                                                   : here->state.position[THETA1] * TURNS_PER_RADIAN;
    excite(&g->waves, cycle_fraction(g, turn), &here->excitation);
    here->lag = 0.0;
    evaluate(g, here);
    return turn;
}

static bool is_finite(const struct moment *moment)
{
    double total = 0.0;
    for (int i = 0; i < FREEDOMS; i++)
        total += moment->state.position[i] + moment->state.velocity[i] + moment->point.acceleration[i];
    return isfinite(total);
}

/* One row of all channels and the accumulated angles of both shafts. */
static void write_sample(const struct gearbox *g, double time, double turn, double *row, double *angles)
{
    const struct constants *k = &g->constants;
    const struct state *state = &g->here->state;
    const struct point *point = &g->here->point;
    const double *position = state->position;
    const double mesh_turn = k->teeth1 * turn;

    *row++ = time;
    *row++ = point->q;
    *row++ = point->q_rate;
    *row++ = point->mesh_force;
    *row++ = atan(point->tan_alpha);
    *row++ = atan2(position[Y2] - position[Y1], k->centre_distance + position[X2] - position[X1]);
    *row++ = point->half_backlash;
    *row++ = g->contacts.flank;
    for (int i = X1; i <= Y2; i++)
        *row++ = position[i];
    for (int i = 0; i < 2; i++) {
        *row++ = point->bearing[i].contact_x;
        *row++ = point->bearing[i].contact_y;
    }
    for (int i = 0; i < 2; i++) {
        *row++ = point->bearing[i].film_x;
        *row++ = point->bearing[i].film_y;
    }
    for (int i = 0; i < 2; i++)
        *row++ = point->bearing[i].penetration;
    *row++ = state->velocity[OMEGA1];
    *row++ = state->velocity[OMEGA2];
    *row++ = g->drive_torque;
    *row++ = point->load_torque;
    *row++ = position[THETA1];
    *row++ = TWO_PI * (mesh_turn - floor(mesh_turn));
    angles[0] = TWO_PI * (double)g->revolutions + position[THETA1];
    angles[1] = (k->base_radius[0] * angles[0] - position[U]) / k->base_radius[1];
}

void gearbox_free(struct gearbox *g)
{
    if (g == NULL)
        return;
    free(g->waves.order);
    free(g->waves.of_cosine);
    free(g);
}

/* amplitudes: a row of EXCITATIONS per wave, of the cosines and then of the sines. NULL if out of memory. */
struct gearbox *gearbox_new(const struct constants *constants, size_t waves, const double *orders,
                            const double *amplitudes)
{
    struct gearbox *g = calloc(1, sizeof *g);
    if (g == NULL)
        return NULL;
    const size_t table = 2 * waves * sizeof *g->waves.of_cosine;
    g->constants = *constants;
    g->waves.count = waves;
    g->waves.order = calloc(3 * waves, sizeof(double));
    g->waves.of_cosine = malloc(table);
    if (g->waves.order == NULL || g->waves.of_cosine == NULL) {
        gearbox_free(g);
        return NULL;
    }
    memcpy(g->waves.order, orders, waves * sizeof(double));
    memcpy(g->waves.of_cosine, amplitudes, table);
    g->waves.cosine = g->waves.order + waves;
    g->waves.sine = g->waves.cosine + waves;
    g->waves.of_sine = g->waves.of_cosine + waves;
    g->here = &g->moments[0];
    g->end = &g->moments[1];
    return g;
}

/* The start: shafts turning at omega1, omega2, the drive flank just touching. */
void gearbox_start(struct gearbox *g, double speed, double drive_torque, double load_torque, double omega1,
                   double omega2)
{
    struct moment *here = g->here;
    g->speed = speed;
    g->drive_torque = g->governor = drive_torque;
    g->load_torque = load_torque;
    g->contacts.impact_speed[0] = g->contacts.impact_speed[1] = g->constants.minimum_impact_speed;
    here->state.velocity[OMEGA1] = omega1;
    here->state.velocity[OMEGA2] = omega2;
    open_point(g);
    here->state.position[U] = here->point.half_backlash - here->point.q;
    g->contacts.flank = here->point.surfaces.rate[UPPER_GAP] < 0.0;
}

/* Integrate; row i of rows (CHANNELS each) and angles (2 each) is the state before its steps. */
int gearbox_advance(struct gearbox *g, size_t first_sample, size_t interval_ns, size_t samples, double *rows,
                    double *angles, size_t *written)
{
    const double limit = g->constants.speed_limit;
    for (size_t i = 0; i < samples; i++) {
        if (g->constants.governed)
            govern(g);
        const double turn = open_point(g);
        *written = i;
        if (!is_finite(g->here))
            return NON_FINITE;
        const double time = (double)((first_sample + i) * interval_ns) / 1e9;
        write_sample(g, time, turn, rows + CHANNELS * i, angles + 2 * i);
        *written = i + 1;
        const double *velocity = g->here->state.velocity;
        if (fabs(velocity[OMEGA1]) > limit || fabs(velocity[OMEGA2]) > limit)
            return OVER_SPEED;
        if (g->here->point.half_backlash <= 0.0 || g->pressed)
            return CENTRES_PRESSED;
        for (int64_t n = 0; n < g->constants.steps_per_sample; n++)
            make_step(g);
    }
    return RUNNING;
}

struct counters gearbox_counters(const struct gearbox *g)
{
    return g->counters;
}

/* Right-hand sides one after the other, each from the last; the result keeps them from being dropped. */
double gearbox_evaluations(const struct gearbox *g, size_t count)
{
    struct moment moment = *g->here;
    double rate[FREEDOMS], total = 0.0;
    for (size_t n = 0; n < count; n++) {
        const double h = n & 1 ? -1e-9 : 1e-9;
        struct point point;
        dynamics(g, &moment.state, moment.excitation.sum, 0.0, &point);
        position_rates(&g->constants, &moment.state, rate);
        move(&moment.state, h, rate, point.acceleration, &moment.state);
        total += point.mesh_force;
    }
    return total + moment.state.position[U];
}

/* Sums of excitations, each at a phase that depends on the one before. */
double gearbox_excitations(const struct gearbox *g, size_t count)
{
    struct excitation excitation = {{0.0}};
    for (size_t n = 0; n < count; n++) {
        const double turn = (double)(n & 1023) / 1024.0 + 1e-3 * excitation.sum[SURFACE];
        excite(&g->waves, turn, &excitation);
    }
    return excitation.sum[SURFACE];
}
