{% macro state(b) %}
    /* Interventions, over all tests since init. */
    long steps; /* commands */
    long acted; /* of them changed */
    long braked; /* of them replaced by braking */
    long not_finite; /* of them that were no finite number */
    long faults[{{ b.s }}]; /* readings left out as faulty, by channel */
    long other_faults; /* observations in which another entry was not finite */
    real largest; /* largest change of a finite command [-] */
    /* Braking prediction. */
    real commands[{{ b.c }}]; /* sent and still under way, oldest first [A] */
    real velocity; /* as last read [m/s] */
    real expected[{{ b.h }}]; /* velocity that was expected for now, under each specimen [m/s] */
    real specimens[{{ b.h * b.m }}]; /* relative displacements and velocities of each */
    real force[{{ b.h }}]; /* on the table, besides that specimen's [N] */
    int started;
    /* Kalman filter of the readings; scaled. x_A, the force, and the accelerometer's low-pass, if any. */
    real state[{{ b.states }}];
    real covariance[{{ b.states * b.states }}];
    real before[{{ b.s }}]; /* readings of the period before [SI] */
    int has_before[{{ b.s }}];
    int equal[{{ b.s }}]; /* readings in a row that were equal */
    int faulty[{{ b.s }}]; /* readings of that period that were left out */
    real misfit[4]; /* recent innovations that noise does not explain [SI] */
    real held[{{ b.n }}]; /* last finite value of each entry of the observation */
    {{ b.inner.type }} inner;
{% endmacro %}
{% macro code(b) %}
{% set N = b.name %}
{% set S = b.states %}
/* Table and covariance of the filter at rest, no commands under way. */
static void {{ N }}_reset({{ b.type }} *s)
{
    fill(s->commands, {{ b.c }}, {{ 0.0|real }});
    fill(s->expected, {{ b.h }}, {{ 0.0|real }});
    fill(s->specimens, {{ b.h * b.m }}, {{ 0.0|real }});
    fill(s->force, {{ b.h }}, {{ 0.0|real }});
    s->velocity = {{ 0.0|real }};
    s->started = 0;
    fill(s->state, {{ S }}, {{ 0.0|real }});
    fill(s->covariance, {{ S * S }}, {{ 0.0|real }});
    for (int i = 0; i < {{ S }}; i++) {
        s->covariance[{{ S + 1 }} * i] = {{ N }}_rest[i];
    }
    for (int i = 0; i < {{ b.s }}; i++) {
        s->before[i] = {{ 0.0|real }};
        s->has_before[i] = 0;
        s->equal[i] = 0;
        s->faulty[i] = 0;
    }
    fill(s->misfit, 4, {{ 0.0|real }});
    fill(s->held, {{ b.n }}, {{ 0.0|real }});
    {{ b.inner.name }}_reset(&s->inner);
}

static void {{ N }}_init({{ b.type }} *s)
{
    s->steps = 0;
    s->acted = 0;
    s->braked = 0;
    s->not_finite = 0;
    s->other_faults = 0;
    s->largest = {{ 0.0|real }};
    for (int i = 0; i < {{ b.s }}; i++) {
        s->faults[i] = 0;
    }
}

/* Readings that cannot be true: no number, out of range, or equal for longer than noise allows. */
static void {{ N }}_credible({{ b.type }} *s, const real *readings, int *faulty)
{
    real together = {{ 0.0|real }};
    int same[{{ b.s }}];

    for (int i = 0; i < {{ b.s }}; i++) {
        /* equal, without a comparison that a NaN would pass */
        same[i] = s->has_before[i] != 0 && readings[i] <= s->before[i] && readings[i] >= s->before[i]
            && {{ N }}_rarity[i] > {{ 0.0|real }};
        s->equal[i] = (same[i] != 0) ? s->equal[i] + 1 : 0;
        together += (same[i] != 0) ? {{ N }}_rarity[i] : {{ 0.0|real }};
    }
    for (int i = 0; i < {{ b.s }}; i++) {
        const int impossible = !(absolute(readings[i]) <= {{ N }}_reach[i]) || !isfinite(readings[i]);
        const int stuck = (real)s->equal[i] * {{ N }}_rarity[i] >= {{ b.rare|real }}
            || (same[i] != 0 && together >= {{ b.rare|real }});

        /* What was wrong is no better for being repeated. */
        faulty[i] = impossible || stuck || (same[i] != 0 && s->faulty[i] != 0);
    }
}

/* Weigh the readings; return the present table x_A, the rms error beyond that of the readings, and
 * what the filter expects of each sensor. */
static void {{ N }}_look({{ b.type }} *s, const real *readings, int *faulty, real *table, real *deviation,
    real *expected)
{
    real innovation[{{ b.s }}], spread[{{ S * b.s }}], size[{{ b.s }}], correlation[{{ b.s * b.s }}];
    real W[{{ b.s * b.s }}], e[{{ b.s }}], y[{{ b.s }}], K[{{ S * b.s }}];
    real left[{{ S * S }}], half[{{ S * S }}], joined[{{ S * S }}];
    int fits = 1;

    {{ N }}_credible(s, readings, faulty);
    product({{ N }}_C, {{ b.s }}, {{ S }}, s->state, innovation);
    for (int i = 0; i < {{ b.s }}; i++) {
        const real value = isfinite(readings[i]) ? readings[i] : {{ 0.0|real }};

        innovation[i] = value / {{ N }}_unit[i] - innovation[i];
    }
    for (int i = 0; i < {{ S }}; i++) {
        for (int j = 0; j < {{ b.s }}; j++) {
            spread[i * {{ b.s }} + j] = dot(&s->covariance[{{ S }} * i], &{{ N }}_C[{{ S }} * j], {{ S }});
        }
    }
    for (int i = 0; i < {{ b.s }}; i++) {
        for (int j = 0; j < {{ b.s }}; j++) {
            real sum = (i == j) ? {{ N }}_R[i] : {{ 0.0|real }};

            for (int k = 0; k < {{ S }}; k++) {
                sum += {{ N }}_C[{{ S }} * i + k] * spread[k * {{ b.s }} + j];
            }
            correlation[i * {{ b.s }} + j] = sum;
        }
    }
    for (int i = 0; i < {{ b.s }}; i++) {
        size[i] = real_sqrt(correlation[i * {{ b.s }} + i]);
    }
    for (int pass = 0; pass <= {{ b.s }}; pass++) { /* each pass leaves out one reading or more */
        real unlikely = {{ 0.0|real }};
        real worst = {{ -1.0|real }};
        real share[{{ b.s }}];

        for (int i = 0; i < {{ b.s }}; i++) {
            for (int j = 0; j < {{ b.s }}; j++) {
                const int weighs = faulty[i] == 0 && faulty[j] == 0;

                W[i * {{ b.s }} + j] = (i == j) ? {{ 1.0|real }}
                    : (weighs ? correlation[i * {{ b.s }} + j] / (size[i] * size[j]) : {{ 0.0|real }});
            }
            e[i] = (faulty[i] == 0) ? innovation[i] / size[i] : {{ 0.0|real }};
        }
        {{ N }}_invert(W);
        product(W, {{ b.s }}, {{ b.s }}, e, y);
        unlikely = dot(e, y, {{ b.s }});
        if (!(unlikely > {{ b.gate|real }})) {
            break;
        }
        for (int i = 0; i < {{ b.s }}; i++) {
            share[i] = y[i] * y[i] / W[i * {{ b.s }} + i];
            worst = (share[i] > worst) ? share[i] : worst;
        }
        for (int i = 0; i < {{ b.s }}; i++) {
            if (share[i] >= worst) {
                faulty[i] = 1;
            }
        }
    }
    for (int i = 0; i < {{ S }}; i++) {
        for (int j = 0; j < {{ b.s }}; j++) {
            spread[i * {{ b.s }} + j] = (faulty[j] == 0) ? spread[i * {{ b.s }} + j] / size[j] : {{ 0.0|real }};
        }
        s->state[i] += dot(&spread[i * {{ b.s }}], y, {{ b.s }});
    }
    for (int i = 0; i < {{ S }}; i++) {
        for (int j = 0; j < {{ b.s }}; j++) {
            real sum = {{ 0.0|real }};

            for (int k = 0; k < {{ b.s }}; k++) {
                sum += spread[i * {{ b.s }} + k] * W[k * {{ b.s }} + j];
            }
            K[i * {{ b.s }} + j] = (faulty[j] == 0) ? sum / size[j] : {{ 0.0|real }};
        }
    }
    /* Joseph's form, which rounding leaves positive. */
    for (int i = 0; i < {{ S }}; i++) {
        for (int j = 0; j < {{ S }}; j++) {
            real sum = (i == j) ? {{ 1.0|real }} : {{ 0.0|real }};

            for (int k = 0; k < {{ b.s }}; k++) {
                sum -= K[i * {{ b.s }} + k] * {{ N }}_C[{{ S }} * k + j];
            }
            left[{{ S }} * i + j] = sum;
        }
    }
    multiply(left, s->covariance, {{ S }}, {{ S }}, {{ S }}, half);
    for (int i = 0; i < {{ S }}; i++) {
        for (int j = 0; j < {{ S }}; j++) {
            joined[{{ S }} * i + j] = dot(&half[{{ S }} * i], &left[{{ S }} * j], {{ S }});
            for (int k = 0; k < {{ b.s }}; k++) {
                joined[{{ S }} * i + j] += K[i * {{ b.s }} + k] * {{ N }}_R[k] * K[j * {{ b.s }} + k];
            }
        }
    }
    copy(joined, s->covariance, {{ S * S }});
    for (int i = 0; i < 4; i++) {
        fits = fits && faulty[i] == 0;
    }
    for (int i = 0; i < 4; i++) {
        real unexplained = {{ 0.0|real }};

        if (faulty[i] == 0 && s->has_before[i] != 0) {
            unexplained = {{ N }}_size[i] * (absolute(innovation[i]) - {{ N }}_usual[i]);
        }
        s->misfit[i] = larger({{ b.fading|real }} * s->misfit[i], unexplained);
        table[i] = (fits != 0) ? readings[i] : {{ N }}_size[i] * s->state[i];
        deviation[i] = (fits != 0) ? {{ 0.0|real }} : {{ N }}_size[i] * real_sqrt(larger(s->covariance[{{ S + 1 }} * i], {{ 0.0|real }}));
    }
    product({{ N }}_C, {{ b.s }}, {{ S }}, s->state, expected);
    for (int i = 0; i < {{ b.s }}; i++) {
        expected[i] *= {{ N }}_unit[i];
        if (isfinite(readings[i])) {
            s->before[i] = readings[i];
            s->has_before[i] = 1;
        }
        s->faulty[i] = faulty[i];
        s->faults[i] += (faulty[i] != 0) ? 1 : 0;
    }
}

/* State and covariance of the next period, under the commands (oldest first, the present one last). */
static void {{ N }}_predict({{ b.type }} *s, const real *queue, real flow)
{
    real state[{{ S }}], errors[{{ 3 * S }}], half[{{ S * S }}], next[{{ S * S }}], held;
    const real late = {{ b.delay_error|real }} * (queue[{{ b.c }}] - queue[0]);

    product({{ N }}_A, {{ S }}, {{ S }}, s->state, state);
    for (int i = 0; i < {{ S }}; i++) {
        held = dot(&{{ N }}_current[i * {{ b.c + 1 }}], queue, {{ b.c + 1 }});
        state[i] += held + flow * {{ N }}_flow[i];
        errors[3 * i] = {{ b.gain_error|real }} * held;
        errors[3 * i + 1] = late * {{ N }}_current_sum[i];
    }
    for (int i = 0; i < {{ S }}; i++) {
        errors[3 * i + 2] = (state[0] - s->state[0]) * {{ N }}_oil[i];
    }
    multiply({{ N }}_A, s->covariance, {{ S }}, {{ S }}, {{ S }}, half);
    for (int i = 0; i < {{ S }}; i++) {
        for (int j = 0; j < {{ S }}; j++) {
            next[{{ S }} * i + j] = dot(&half[{{ S }} * i], &{{ N }}_A[{{ S }} * j], {{ S }}) + {{ N }}_Q[{{ S }} * i + j]
                + dot(&errors[3 * i], &errors[3 * j], 3);
        }
    }
    copy(state, s->state, {{ S }});
    copy(next, s->covariance, {{ S * S }});
}

/* What the velocity says of the specimens and of the forces on the table. */
static void {{ N }}_weigh({{ b.type }} *s, real velocity)
{
    const real before = (s->started != 0) ? s->velocity : velocity;

    if (s->started != 0) {
        for (int h = 0; h < {{ b.h }}; h++) {
            real carried[{{ b.m + 2 }}];

            copy(&s->specimens[h * {{ b.m }}], carried, {{ b.m }});
            carried[{{ b.m }}] = before;
            carried[{{ b.m + 1 }}] = velocity;
            s->force[h] += {{ b.trust|real }} * (velocity - s->expected[h]) / {{ N }}_push[h];
            product(&{{ N }}_carry[h * {{ b.m * (b.m + 2) }}], {{ b.m }}, {{ b.m + 2 }}, carried, &s->specimens[h * {{ b.m }}]);
        }
    }
    s->velocity = velocity;
    s->started = 1;
}

/* Move a command to where braking from the next period on would keep every limit. */
static real {{ N }}_limit({{ b.type }} *s, const real *table, const real *deviation, int failed, real wanted,
    real flow, real *queue)
{
    const int finite = isfinite(wanted) ? 1 : 0;
    const real asked = (finite != 0) ? clip(wanted, {{ -1.0|real }}, {{ 1.0|real }}) : {{ 0.0|real }};
    real margin[4], z[{{ b.columns }}], exact[{{ b.columns }}];
    real upper = (real)INFINITY, lower = (real)-INFINITY, low, high, sent, change, brake;
    int braking, acted;

    for (int i = 0; i < 4; i++) {
        margin[i] = rounded({{ b.deviations|real }} * deviation[i] + {{ b.misfit_share|real }} * s->misfit[i]);
    }
    for (int h = 0; h < {{ b.h }}; h++) {
        {{ N }}_join(s, h, table, flow, exact);
        for (int i = 0; i < {{ b.columns }}; i++) {
            z[i] = rounded(exact[i]);
        }
        for (int r = 0; r < {{ b.rows_count }}; r++) {
            const real *row = &{{ N }}_rows[(h * {{ b.rows_count }} + r) * {{ b.columns }}];
            const real across = dot(row, z, {{ b.columns }});
            real reach = {{ N }}_bound[h * {{ b.rows_count }} + r];

            for (int i = 0; i < 4; i++) {
                reach -= margin[i] * absolute(row[i]);
            }
            upper = smaller(upper, reach - across);
            lower = larger(lower, -(reach + across));
        }
    }
    upper /= {{ b.limit|real }};
    lower /= {{ b.limit|real }};
    brake = -(dot({{ N }}_feedback, table, 4) + dot(&{{ N }}_feedback[4], s->commands, {{ b.c }})) / {{ b.limit|real }};
    braking = finite == 0 || !(lower <= upper) || failed != 0;
    /* Where two limits contradict each other, what lies between their demands breaks each a little. */
    low = smaller(lower, upper);
    high = larger(lower, upper);
    sent = smaller(larger((braking != 0) ? brake : asked, low), high);
    sent = rounded(clip(sent, {{ -b.most|real }}, {{ b.most|real }}));
    change = (finite != 0) ? absolute(sent - asked) : {{ 0.0|real }};
    acted = finite == 0 || change > {{ b.rounding|real }};
    copy(s->commands, queue, {{ b.c }});
    queue[{{ b.c }}] = {{ b.limit|real }} * sent;
    for (int h = 0; h < {{ b.h }}; h++) {
        const real *row = &{{ N }}_velocity[h * {{ b.columns + 1 }}];

        {{ N }}_join(s, h, table, flow, exact);
        s->expected[h] = dot(row, exact, {{ b.columns }}) + row[{{ b.columns }}] * queue[{{ b.c }}];
    }
    copy(&queue[1], s->commands, {{ b.c }});
    s->steps += 1;
    s->acted += (acted != 0) ? 1 : 0;
    s->braked += (braking != 0 && acted != 0) ? 1 : 0;
    s->not_finite += (finite == 0) ? 1 : 0;
    s->largest = larger(s->largest, change);
    return sent;
}

static void {{ N }}_step({{ b.type }} *s, const real *y, real *action)
{
    real readings[{{ b.s }}], expected[{{ b.s }}], shown[{{ b.n }}], queue[{{ b.c + 1 }}];
    real table[4], deviation[4], wanted, flow;
    int faulty[{{ b.s }}];
    int failed = 0, other = 0;

    for (int i = 0; i < {{ b.s }}; i++) {
        readings[i] = y[{{ N }}_places[i]] * {{ N }}_scale[i];
    }
    {{ N }}_look(s, readings, faulty, table, deviation, expected);
    /* The controller is shown what is believed in place of a faulty reading, and the last finite value
     * of any other entry, so that nothing that is not a number stays in its memory. */
    for (int i = 0; i < {{ b.n }}; i++) {
        if (isfinite(y[i])) {
            s->held[i] = y[i];
        } else {
            other = other || {{ N }}_is_reading[i] == 0;
        }
        shown[i] = s->held[i];
    }
    s->other_faults += (other != 0) ? 1 : 0;
    for (int i = 0; i < {{ b.s }}; i++) {
        if (faulty[i] != 0) {
            shown[{{ N }}_places[i]] = rounded(expected[i] / {{ N }}_scale[i]);
            failed = failed || i < 4;
        }
    }
    {{ b.inner.name }}_step(&s->inner, shown, &wanted);
    {{ N }}_weigh(s, table[2]);
    flow = {% if b.flow_active %}valve_opening(table[3], table[0]) - table[3]{% else %}{{ 0.0|real }}{% endif %};
    *action = {{ N }}_limit(s, table, deviation, failed, wanted, flow, queue);
    {{ N }}_predict(s, queue, flow);
}
{% endmacro %}
{% macro before(b) %}
{% set N = b.name %}
/* Inverse of a symmetric positive definite matrix, in place, by Gauss and Jordan. */
static void {{ N }}_invert(real *m)
{
    for (int p = 0; p < {{ b.s }}; p++) {
        const real pivot = {{ 1.0|real }} / m[p * {{ b.s }} + p];

        for (int i = 0; i < {{ b.s }}; i++) {
            for (int j = 0; j < {{ b.s }}; j++) {
                if (i != p && j != p) {
                    m[i * {{ b.s }} + j] -= m[i * {{ b.s }} + p] * pivot * m[p * {{ b.s }} + j];
                }
            }
        }
        for (int i = 0; i < {{ b.s }}; i++) {
            if (i != p) {
                m[i * {{ b.s }} + p] *= -pivot;
                m[p * {{ b.s }} + i] *= pivot;
            }
        }
        m[p * {{ b.s }} + p] = pivot;
    }
}

/* What a prediction starts from under specimen h: table, specimen, force, flow, commands under way. */
static void {{ N }}_join(const {{ b.type }} *s, int h, const real *table, real flow, real *z)
{
    copy(table, z, 4);
    copy(&s->specimens[h * {{ b.m }}], &z[4], {{ b.m }});
    z[{{ 4 + b.m }}] = s->force[h];
    z[{{ 5 + b.m }}] = flow;
    copy(s->commands, &z[{{ 6 + b.m }}], {{ b.c }});
}

{% endmacro %}
