{% macro state(b) %}
{% if b.observed %}
    real specimen[{{ b.F * b.n }}]; /* of each candidate frequency, SI */
    real reference[{{ b.F * b.n }}];
    real acceleration; /* last table acceleration [m/s^2] */
    real lowpassed; /* and its reading */
    real target; /* last target acceleration [m/s^2] */
{% endif %}
    double moments[{{ 2 * b.F }}]; /* forgetting sums of phi^2 and phi f [N^2], of each frequency */
    double square; /* and of f^2; f the shear that the table weighs, phi the one at mass ratio 1 */
    real phi[{{ b.F }}]; /* last phi [N] */
    real table[4]; /* actuator's state of the last period, SI */
    real commands[2]; /* last command, and the one before [A] */
    int started;
{% endmacro %}
{% macro before(b) %}
{% set N = b.name %}
/* Probability of each frequency, and its mass ratio. The evidence is a small difference of large sums:
 * it is computed in double, whatever the program's precision. */
static void {{ N }}_posterior(const {{ b.type }} *s, real *weight, real *mass)
{
    double evidence[{{ b.F }}];
    double least = (double)INFINITY, sum = 0.0;

    for (int i = 0; i < {{ b.F }}; i++) {
        const double phi_phi = s->moments[2 * i], phi_f = s->moments[2 * i + 1];
        const double precision = phi_phi / {{ b.variance|exact }} + {{ (1.0 / b.prior_variance)|exact }};
        double ratio = (phi_f / {{ b.variance|exact }} + {{ (b.prior_mean / b.prior_variance)|exact }}) / precision;
        double left, off;

        ratio = (ratio < {{ b.low|exact }}) ? {{ b.low|exact }} : ratio;
        ratio = (ratio > {{ b.high|exact }}) ? {{ b.high|exact }} : ratio;
        left = s->square - 2.0 * ratio * phi_f + ratio * ratio * phi_phi;
        off = ratio - {{ b.prior_mean|exact }};
        evidence[i] = left / {{ b.variance|exact }} + off * off / {{ b.prior_variance|exact }}
            + log(precision * {{ b.prior_variance|exact }});
        least = (evidence[i] < least) ? evidence[i] : least;
        mass[i] = (real)ratio;
    }
    for (int i = 0; i < {{ b.F }}; i++) {
        evidence[i] = exp(-0.5 * (evidence[i] - least));
        sum += evidence[i];
    }
    for (int i = 0; i < {{ b.F }}; i++) {
        weight[i] = (real)(evidence[i] / sum);
    }
}

/* Take up a period of the shear f; a test's start tells nothing. */
static void {{ N }}_learn({{ b.type }} *s, const real *phi, real f)
{
    const double weighed = (s->started != 0) ? (double)f : 0.0;

    for (int i = 0; i < {{ b.F }}; i++) {
        const double expected = (s->started != 0) ? (double)phi[i] : 0.0;

        s->moments[2 * i] = {{ b.forget|exact }} * s->moments[2 * i] + expected * expected;
        s->moments[2 * i + 1] = {{ b.forget|exact }} * s->moments[2 * i + 1] + expected * weighed;
    }
    s->square = {{ b.forget|exact }} * s->square + weighed * weighed;
}

/* Current [A] of frequency i at its own mass ratio. */
static real {{ N }}_wanted(int i, real mass, const real *features)
{
{% if b.M == 1 %}
    (void)mass;
    return dot(&{{ N }}_laws[i * {{ b.entries }}], features, {{ b.entries }});
{% else %}
    const real place = (mass - {{ b.low|real }}) * {{ ((b.M - 1) / (b.high - b.low))|real }};
    const int at = (place < {{ (b.M - 2.0)|real }}) ? (int)place : {{ b.M - 2 }};
    const real share = place - (real)at;
    const real *law = &{{ N }}_laws[(i * {{ b.M }} + at) * {{ b.entries }}];

    return ({{ 1.0|real }} - share) * dot(law, features, {{ b.entries }})
        + share * dot(&law[{{ b.entries }}], features, {{ b.entries }});
{% endif %}
}

{% if b.observed %}
/* Advance a specimen of each frequency under a base acceleration, last and present. */
static void {{ N }}_advance_all(real *specimens, real last, real present)
{
    for (int i = 0; i < {{ b.F }}; i++) {
        real moved[{{ b.n }}];

        product(&{{ N }}_advance[i * {{ b.n * b.n }}], {{ b.n }}, {{ b.n }}, &specimens[i * {{ b.n }}], moved);
        for (int j = 0; j < {{ b.n }}; j++) {
            specimens[i * {{ b.n }} + j] = moved[j] + {{ N }}_now[i * {{ b.n }} + j] * last
                + {{ N }}_following[i * {{ b.n }} + j] * present;
        }
    }
}

/* Estimate the table from the readings and the base shear at the period's start and end [N]. */
static void {{ N }}_observe({{ b.type }} *s, const real *readings, real start, real end)
{
    real predicted[4], innovation[5];

    product({{ N }}_table_A, 4, 4, s->table, predicted);
    for (int i = 0; i < 4; i++) {
        predicted[i] += s->commands[0] * {{ N }}_on_last[i] + s->commands[1] * {{ N }}_on_previous[i]
            + start * {{ N }}_table_now[i] + end * {{ N }}_table_following[i];
    }
    product({{ N }}_table_C, 5, 4, predicted, innovation);
    for (int i = 0; i < 5; i++) {
        innovation[i] = readings[i] - innovation[i];
    }
    innovation[4] -= end / {{ b.table_mass|real }};
    add_product({{ N }}_table_gain, 4, 5, innovation, predicted);
    copy(predicted, s->table, 4);
}

{% endif %}
{% endmacro %}
{% macro code(b) %}
{% set N = b.name %}
static void {{ N }}_reset({{ b.type }} *s)
{
{% if b.observed %}
    fill(s->specimen, {{ b.F * b.n }}, {{ 0.0|real }});
    fill(s->reference, {{ b.F * b.n }}, {{ 0.0|real }});
    s->acceleration = {{ 0.0|real }};
    s->lowpassed = {{ 0.0|real }};
    s->target = {{ 0.0|real }};
{% endif %}
    for (int i = 0; i < {{ 2 * b.F }}; i++) {
        s->moments[i] = 0.0;
    }
    s->square = 0.0;
    fill(s->phi, {{ b.F }}, {{ 0.0|real }});
    fill(s->table, 4, {{ 0.0|real }});
    fill(s->commands, 2, {{ 0.0|real }});
    s->started = 0;
}

static void {{ N }}_step({{ b.type }} *s, const real *y, real *action)
{
    real head[{{ b.scale.size }}], features[{{ b.entries }}];
    real phi[{{ b.F }}], weight[{{ b.F }}], mass[{{ b.F }}];
    real current = {{ 0.0|real }};
{% if b.observed %}
    real readings[5], shear[2] = { {{- 0.0|real }}, {{ 0.0|real -}} }, raw, target;
{% endif %}

    for (int i = 0; i < {{ b.scale.size }}; i++) {
        head[i] = y[i] * {{ N }}_scale[i];
    }
{% if b.last_action is not none %}
    s->commands[0] = {{ b.limit|real }} * y[{{ b.last_action }}]; /* what was given, whoever changed it */
{% endif %}
{% if b.observed %}
    for (int i = 0; i < 5; i++) {
        readings[i] = y[{{ N }}_places[i]] * {{ N }}_reading_scale[i];
    }
    raw = readings[4];
    readings[4] += {{ b.lead|real }} * (raw - s->lowpassed); /* the sensor's low-pass undone */
    target = dot({{ N }}_source, head, {{ b.w }});
    {{ N }}_advance_all(s->specimen, s->acceleration, readings[4]);
    {{ N }}_advance_all(s->reference, s->target, target);
    for (int i = 0; i < {{ b.F }}; i++) {
        phi[i] = dot(&{{ N }}_shear[i * {{ b.n }}], &s->specimen[i * {{ b.n }}], {{ b.n }});
    }
    {{ N }}_learn(s, phi, dot({{ N }}_balance, readings, 5));
    {{ N }}_posterior(s, weight, mass);
    for (int i = 0; i < {{ b.F }}; i++) {
        shear[0] += weight[i] * mass[i] * s->phi[i];
        shear[1] += weight[i] * mass[i] * phi[i];
    }
    {{ N }}_observe(s, readings, shear[0], shear[1]);
    s->acceleration = readings[4];
    s->lowpassed = raw;
    s->target = target;
{% else %}
    for (int i = 0; i < {{ b.F }}; i++) {
        real between;

        phi[i] = dot(&{{ N }}_shear[i * {{ b.n }}], &head[{{ b.first_specimen }}], {{ b.n }});
        between = {{ 0.5|real }} * (s->phi[i] + phi[i]);
        s->phi[i] = phi[i];
        phi[i] = between;
    }
    {{ N }}_learn(s, phi, dot(&{{ N }}_impulse[0], s->table, 4) + dot(&{{ N }}_impulse[4], &head[{{ b.w }}], 4));
    {{ N }}_posterior(s, weight, mass);
    copy(&head[{{ b.w }}], s->table, 4);
{% endif %}
    copy(head, features, {{ b.w }});
    copy(s->table, &features[{{ b.w }}], 4);
    for (int i = 0; i < {{ b.preview }}; i++) {
        features[{{ b.w + 4 + 2 * b.n }} + i] = y[{{ b.first_preview }} + i] * {{ b.preview_scale|real }};
    }
    features[{{ b.entries - 1 }}] = s->commands[0];
    for (int i = 0; i < {{ b.F }}; i++) {
{% if b.observed %}
        s->phi[i] = phi[i];
        copy(&s->specimen[i * {{ b.n }}], &features[{{ b.w + 4 }}], {{ b.n }});
        copy(&s->reference[i * {{ b.n }}], &features[{{ b.w + 4 + b.n }}], {{ b.n }});
{% else %}
        copy(&head[{{ b.first_specimen }}], &features[{{ b.w + 4 }}], {{ b.n }});
        copy(&head[{{ b.first_reference }}], &features[{{ b.w + 4 + b.n }}], {{ b.n }});
{% endif %}
        current += weight[i] * {{ N }}_wanted(i, mass[i], features);
    }
    current = clip(current, {{ -b.limit|real }}, {{ b.limit|real }});
    s->commands[1] = s->commands[0];
    s->commands[0] = current;
    s->started = 1;
    *action = rounded(current / {{ b.limit|real }});
}
{% endmacro %}
