{% macro state(b) %}
    real table[{{ b.states }}]; /* the filter's estimate, observation units */
    real actions[{{ b.actions }}]; /* own actions, oldest first [-] */
    real ground[{{ b.w }}]; /* ground filter's state as last shown */
    real reference[{{ b.r }}]; /* reference specimen's state */
    int age; /* control periods since the start, up to {{ b.periods - 1 }} */
    int started;
    {{ b.inner.type }} inner;
{% endmacro %}
{% macro code(b) %}
static void {{ b.name }}_reset({{ b.type }} *s)
{
    fill(s->table, {{ b.states }}, {{ 0.0|real }});
    fill(s->actions, {{ b.actions }}, {{ 0.0|real }});
    fill(s->ground, {{ b.w }}, {{ 0.0|real }});
    fill(s->reference, {{ b.r }}, {{ 0.0|real }});
    s->age = 0;
    s->started = 0;
    {{ b.inner.name }}_reset(&s->inner);
}

static void {{ b.name }}_step({{ b.type }} *s, const real *y, real *action)
{
    real innovation[{{ b.readings }}];
    real known[{{ b.w + b.r + b.preview }}];
    real under_way[{{ b.states + b.actions - 1 }}];
    real exogenous[{{ b.predicted_ground.shape[0] }}];
    real ahead[{{ b.ahead.shape[0] }}];
    real believed[{{ b.believed }}];

    /* Predict over the period that has passed. */
    if (s->started != 0) {
        real table[{{ b.states }}];
        real reference[{{ b.r }}];

{% if b.last_action is not none %}
        s->actions[{{ b.actions - 1 }}] = y[{{ b.last_action }}]; /* what was given, whoever changed it */
{% endif %}
        product({{ b.name }}_A, {{ b.states }}, {{ b.states }}, s->table, table);
        add_product({{ b.name }}_B, {{ b.states }}, {{ b.actions }}, s->actions, table);
        copy(table, s->table, {{ b.states }});
        product({{ b.name }}_S, {{ b.r }}, {{ b.r }}, s->reference, reference);
        add_product({{ b.name }}_W_before, {{ b.r }}, {{ b.w }}, s->ground, reference);
        add_product({{ b.name }}_W_now, {{ b.r }}, {{ b.w }}, &y[0], reference);
        copy(reference, s->reference, {{ b.r }});
        if (s->age < {{ b.periods - 1 }}) {
            s->age++;
        }
    }
    s->started = 1;
    copy(&y[0], s->ground, {{ b.w }});
    /* Correct by the readings. */
    product({{ b.name }}_C, {{ b.readings }}, {{ b.states }}, s->table, innovation);
    for (int i = 0; i < {{ b.readings }}; i++) {
        innovation[i] = y[{{ b.first_reading }} + i] - innovation[i];
    }
    add_product(&{{ b.name }}_gains[s->age * {{ b.states * b.readings }}], {{ b.states }}, {{ b.readings }}, innovation, s->table);
{% if b.first_reference is not none %}
    copy(&y[{{ b.first_reference }}], s->reference, {{ b.r }});
{% endif %}
    /* Predict to the instant at which this action begins to act. */
    copy(s->ground, &known[0], {{ b.w }});
    copy(s->reference, &known[{{ b.w }}], {{ b.r }});
{% if b.preview %}
    copy(&y[{{ b.first_preview }}], &known[{{ b.w + b.r }}], {{ b.preview }});
{% endif %}
    product({{ b.name }}_predicted_ground, {{ b.predicted_ground.shape[0] }}, {{ b.w + b.r + b.preview }}, known, exogenous);
    copy(s->table, under_way, {{ b.states }});
{% if b.actions > 1 %}
    copy(&s->actions[1], &under_way[{{ b.states }}], {{ b.actions - 1 }});
{% endif %}
    product({{ b.name }}_ahead, {{ b.ahead.shape[0] }}, {{ b.states + b.actions - 1 }}, under_way, ahead);
    for (int i = 0; i < {{ b.w }}; i++) {
        believed[i] = rounded(exogenous[i]);
    }
    for (int i = 0; i < {{ b.ahead.shape[0] }}; i++) {
        believed[{{ b.w }} + i] = rounded(ahead[i]);
    }
    for (int i = {{ b.w }}; i < {{ b.predicted_ground.shape[0] }}; i++) {
        believed[{{ b.ahead.shape[0] }} + i] = rounded(exogenous[i]);
    }
    {{ b.inner.name }}_step(&s->inner, believed, action);
    for (int i = 0; i < {{ b.actions - 1 }}; i++) {
        s->actions[i] = s->actions[i + 1];
    }
    s->actions[{{ b.actions - 1 }}] = clip(*action, {{ -1.0|real }}, {{ 1.0|real }});
}
{% endmacro %}
