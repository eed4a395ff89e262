{% macro state(b) %}
{% if b.law %}
    real known[{{ b.known }}]; /* estimate, own actions, ground, reference specimen */
    int age; /* control periods since the start, up to {{ b.periods - 1 }} */
    int started;
{% endif %}
{% if b.memory == "tcn" %}
{% for width in b.states %}
    real past_{{ loop.index0 }}[{{ width }}]; /* what a convolution will still read, the oldest first */
{% endfor %}
{% elif b.memory %}
    real hidden[{{ b.units }}]; /* memory of the recurrent unit */
{% if b.memory == "lstm" %}
    real cell[{{ b.units }}];
{% endif %}
{% endif %}
    real action; /* last action [-] */
{% endmacro %}
{% macro activation(b, name, size) %}
    for (int i = 0; i < {{ size }}; i++) {
{% if b.activation == "tanh" %}
        {{ name }}[i] = real_tanh({{ name }}[i]);
{% else %}
        {{ name }}[i] = ({{ name }}[i] > {{ 0.0|real }}) ? {{ name }}[i] : {{ 0.0|real }};
{% endif %}
    }
{% endmacro %}
{% macro law(b) %}
/* Weigh the readings of an observation; return what is estimated behind it in x. */
static void {{ b.name }}_look({{ b.type }} *s, const real *y, real *x)
{
    real joined[{{ b.known + b.n }}];
    real both[{{ b.known + b.readings }}];

    copy(s->known, joined, {{ b.known }});
    copy(y, &joined[{{ b.known }}], {{ b.n }});
    {{ product(b, "advance", "joined", "both") }}
    if (s->started == 0) {
        for (int i = 0; i < {{ b.known + b.readings }}; i++) {
            both[i] *= {{ b.name }}_begins[i];
        }
    } else if (s->age < {{ b.periods - 1 }}) {
        s->age++;
    } else {
        /* the last gain serves ever after */
    }
    s->started = 1;
    add_product(&{{ b.name }}_gains[s->age * {{ b.estimates * b.readings }}], {{ b.estimates }}, {{ b.readings }}, &both[{{ b.known }}], both);
    copy(both, s->known, {{ b.known }});
    copy(s->known, joined, {{ b.known }});
    {{ product(b, "show", "joined", "&x[%d]" % b.n) }}
    copy(y, x, {{ b.n }});
}

{% endmacro %}
{% macro gru(b) %}
/* Gated recurrent unit (Cho et al., 2014); gates: reset, update, new. */
static void {{ b.name }}_recall({{ b.type }} *s, real *entering)
{
    real from_input[{{ 3 * b.units }}];
    real from_memory[{{ 3 * b.units }}];

    affine({{ b.name }}_input_weight, {{ b.name }}_input_bias, {{ 3 * b.units }}, {{ b.features }}, entering, from_input);
    affine({{ b.name }}_hidden_weight, {{ b.name }}_hidden_bias, {{ 3 * b.units }}, {{ b.units }}, s->hidden, from_memory);
    for (int i = 0; i < {{ b.units }}; i++) {
        const real reset = logistic(from_input[i] + from_memory[i]);
        const real update = logistic(from_input[{{ b.units }} + i] + from_memory[{{ b.units }} + i]);
        const real proposed = real_tanh(from_input[{{ 2 * b.units }} + i] + reset * from_memory[{{ 2 * b.units }} + i]);

        s->hidden[i] = proposed + update * (s->hidden[i] - proposed);
    }
    copy(s->hidden, &entering[{{ b.features }}], {{ b.units }});
}

{% endmacro %}
{% macro lstm(b) %}
/* Long short-term memory (Hochreiter and Schmidhuber, 1997); gates: input, forget, cell, output. */
static void {{ b.name }}_recall({{ b.type }} *s, real *entering)
{
    real sums[{{ 4 * b.units }}];

    affine({{ b.name }}_input_weight, {{ b.name }}_input_bias, {{ 4 * b.units }}, {{ b.features }}, entering, sums);
    add_product({{ b.name }}_hidden_weight, {{ 4 * b.units }}, {{ b.units }}, s->hidden, sums);
    for (int i = 0; i < {{ 4 * b.units }}; i++) {
        sums[i] += {{ b.name }}_hidden_bias[i];
    }
    for (int i = 0; i < {{ b.units }}; i++) {
        s->cell[i] = logistic(sums[{{ b.units }} + i]) * s->cell[i] + logistic(sums[i]) * real_tanh(sums[{{ 2 * b.units }} + i]);
        s->hidden[i] = logistic(sums[{{ 3 * b.units }} + i]) * real_tanh(s->cell[i]);
    }
    copy(s->hidden, &entering[{{ b.features }}], {{ b.units }});
}

{% endmacro %}
{% macro tcn(b) %}
{% set taps = b.conv_weight_0.size // (b.features * b.units) %}
/* Causal dilated convolutions (Bai, Kolter and Koltun, 2018). */
static void {{ b.name }}_recall({{ b.type }} *s, real *entering)
{
    real *made = &entering[{{ b.features }}];
    real read[{{ taps * [b.features, b.units]|max }}];
    real layer[{{ b.units }}];

{% for apart in b.dilations %}
{% set inputs = b.units if loop.index0 else b.features %}
{% set past = "s->past_%d"|format(loop.index0) %}
{% set width = b.states[loop.index0] %}
    for (int k = 0; k < {{ taps - 1 }}; k++) {
        copy(&{{ past }}[k * {{ apart * inputs }}], &read[k * {{ inputs }}], {{ inputs }});
    }
    copy({{ "made" if loop.index0 else "entering" }}, &read[{{ (taps - 1) * inputs }}], {{ inputs }});
    copy(&{{ past }}[{{ inputs }}], {{ past }}, {{ width - inputs }}); /* the oldest value goes */
    copy(&read[{{ (taps - 1) * inputs }}], &{{ past }}[{{ width - inputs }}], {{ inputs }});
    affine({{ b.name }}_conv_weight_{{ loop.index0 }}, {{ b.name }}_conv_bias_{{ loop.index0 }}, {{ b.units }}, {{ taps * inputs }}, read, layer);
    for (int i = 0; i < {{ b.units }}; i++) {
        made[i] = {{ "made[i] + " if loop.index0 }}larger(layer[i], {{ 0.0|real }});
    }
{% endfor %}
}

{% endmacro %}
{% macro code(b) %}
{% if b.law %}
{{ law(b) }}{% endif %}
{% if b.memory == "gru" %}
{{ gru(b) }}{% elif b.memory == "lstm" %}
{{ lstm(b) }}{% elif b.memory == "tcn" %}
{{ tcn(b) }}{% endif %}
static void {{ b.name }}_reset({{ b.type }} *s)
{
{% if b.law %}
    fill(s->known, {{ b.known }}, {{ 0.0|real }});
    s->age = 0;
    s->started = 0;
{% endif %}
{% if b.memory == "tcn" %}
{% for width in b.states %}
    fill(s->past_{{ loop.index0 }}, {{ width }}, {{ 0.0|real }});
{% endfor %}
{% elif b.memory %}
    fill(s->hidden, {{ b.units }}, {{ 0.0|real }});
{% if b.memory == "lstm" %}
    fill(s->cell, {{ b.units }}, {{ 0.0|real }});
{% endif %}
{% endif %}
    s->action = {{ 0.0|real }};
}

static void {{ b.name }}_step({{ b.type }} *s, const real *y, real *action)
{
    real entering[{{ b.features + b.units }}];
{% for width in b.widths %}
    real layer_{{ loop.index0 }}[{{ width }}{% if b.direct and loop.index == b.widths|length - 1 %} + {{ b.features + b.units }}{% endif %}];
{% endfor %}
    real output;
{% if b.law %}
    real x[{{ b.n + b.shown }}];

    {{ b.name }}_look(s, y, x);
{% else %}
    const real *x = y;

{% endif %}
    {{ product(b, "matrix", "x", "entering") }}
    for (int i = 0; i < {{ b.features }}; i++) {
        entering[i] = clip(entering[i], {{ -b.feature_clip|real }}, {{ b.feature_clip|real }});
    }
{% if b.memory %}
    {{ b.name }}_recall(s, entering); /* its output stands behind the features */
{% endif %}
{% set before = namespace(name="entering", size=b.features + b.units) %}
{% for width in b.widths %}
{% if b.direct and loop.last and not loop.first %}
    copy(entering, &{{ before.name }}[{{ before.size }}], {{ b.features + b.units }}); /* the last layer reads what the first does */
{% set before.size = before.size + b.features + b.units %}
{% endif %}
    affine({{ b.name }}_weight_{{ loop.index0 }}, {{ b.name }}_bias_{{ loop.index0 }}, {{ width }}, {{ before.size }}, {{ before.name }}, layer_{{ loop.index0 }});
{% if not loop.last %}
{{ activation(b, "layer_" ~ loop.index0, width) }}{% endif %}
{% set before.name = "layer_" ~ loop.index0 %}
{% set before.size = width %}
{% endfor %}
    output = {% if b.output == "tanh" %}real_tanh({{ before.name }}[0]){% else %}clip({{ before.name }}[0], {{ -1.0|real }}, {{ 1.0|real }}){% endif %};
    output = dot({{ b.name }}_base, x, {{ b.n + b.shown }}) + {{ b.authority|real }} * output;
    s->action = rounded(clip(output, {{ -1.0|real }}, {{ 1.0|real }}));
{% if b.law %}
    for (int i = {{ b.estimates }}; i < {{ b.estimates + b.actions - 1 }}; i++) {
        s->known[i] = s->known[i + 1];
    }
    s->known[{{ b.estimates + b.actions - 1 }}] = s->action;
{% endif %}
    *action = s->action;
}
{% endmacro %}
