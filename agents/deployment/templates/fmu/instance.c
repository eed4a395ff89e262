{# What both versions of FMI have in common: an instance and one communication step. #}
#include "{{ name }}.h"

#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

#define FIRST 1U /* value reference of the first input; 0 is the time */
#define OK 0
#define ERROR 3
#define VARIABLES ({{ NAME }}_INPUTS + {{ NAME }}_OUTPUTS)

#define MESSAGE 320 /* longest message to the importer */
#define LABEL 128 /* of an instance */

{% if major == "2" %}
typedef void (*log_t)(void *, const char *, int, const char *, const char *, ...);
{% else %}
typedef void (*log_t)(void *, int, const char *, const char *);
{% endif %}

/* Who is told of errors: the importer's callback. */
typedef struct {
    log_t log;
    void *environment;
    char name[LABEL];
} listener_t;

/* Value references: inputs, then outputs, in the order of {{ name }}.h, from FIRST on; SI. */
typedef struct {
    {{ name }}_t memory;
    double values[VARIABLES];
    double time; /* [s] */
} state_t;

typedef struct {
    state_t state;
    listener_t listener;
} instance_t;

static const char *const input_names[{{ NAME }}_INPUTS] = {
{% for channel in inputs %}
    "{{ channel.identifier }} [{{ channel.unit }}]",
{% endfor %}
};

static void tell(const listener_t *listener, const char *format, ...)
{
    char message[MESSAGE];
    va_list given;

    va_start(given, format);
    (void)vsnprintf(message, sizeof message, format, given);
    va_end(given);
    if (listener->log != NULL) {
{% if major == "2" %}
        listener->log(listener->environment, listener->name, ERROR, "logStatusError", message);
{% else %}
        listener->log(listener->environment, ERROR, "logStatusError", message);
{% endif %}
    }
}

static void begin(instance_t *instance)
{
    {{ name }}_init(&instance->state.memory);
    for (int i = 0; i < VARIABLES; i++) {
        instance->state.values[i] = 0.0;
    }
}

static listener_t listener_of(log_t log, void *environment, const char *name)
{
    listener_t made = {log, environment, ""};

    (void)snprintf(made.name, sizeof made.name, "%s", (name != NULL) ? name : "{{ name }}");
    return made;
}

static instance_t *instantiate(const char *token, const listener_t *listener)
{
    instance_t *made = NULL;

    if (token == NULL || strcmp(token, "{{ token }}") != 0) {
        tell(listener, "instantiation token %.64s: this FMU's is {{ token }}; read it from modelDescription.xml",
            (token != NULL) ? token : "(none)");
        return NULL;
    }
    made = (instance_t *)calloc(1, sizeof *made);
    if (made == NULL) {
        tell(listener, "instance of %lu bytes: no memory is left", (unsigned long)sizeof *made);
        return NULL;
    }
    made->listener = *listener;
    begin(made);
    return made;
}

/* Say which inputs a step refused. They must be finite, also as the program scales them. */
static void tell_refused(const instance_t *instance)
{
    for (int i = 0; i < {{ NAME }}_INPUTS; i++) {
        const double value = instance->state.values[i];

        if (!isfinite({% if rounds_inputs %}(float)({% endif %}value / {{ name }}_input_scales[i]{% if rounds_inputs %}){% endif %})) {
            tell(&instance->listener, "fmi{{ major }}DoStep at %.9g s: %s = %g: give a finite number{% if rounds_inputs %} of single precision{% endif %}; the outputs are 0",
                instance->state.time, input_names[i], value);
        }
    }
}

/* Communication steps are whole periods; inputs are held. */
static int do_step(instance_t *instance, double point, double size)
{
    const double periods = floor(size / {{ NAME }}_PERIOD + 0.5);
    {{ name }}_real inputs[{{ NAME }}_INPUTS], outputs[{{ NAME }}_OUTPUTS];
    int code = {{ NAME }}_OK;

    if (!(periods >= 1.0) || fabs(size - periods * {{ NAME }}_PERIOD) > 1e-6 * {{ NAME }}_PERIOD) {
        tell(&instance->listener, "fmi{{ major }}DoStep at %.9g s: communication step = %.9g s: give a whole number of control periods of {{ period }} s",
            point, size);
        return ERROR;
    }
    instance->state.time = point;
    for (int i = 0; i < {{ NAME }}_INPUTS; i++) {
        inputs[i] = ({{ name }}_real)instance->state.values[i];
    }
    for (long k = 0; k < (long)periods && code == {{ NAME }}_OK; k++) {
        code = {{ name }}_step_si(&instance->state.memory, inputs, outputs);
        for (int i = 0; i < {{ NAME }}_OUTPUTS; i++) {
            instance->state.values[{{ NAME }}_INPUTS + i] = (double)outputs[i];
        }
    }
    if (code == {{ NAME }}_REFUSED) {
        tell_refused(instance);
    } else if (code != {{ NAME }}_OK) {
        tell(&instance->listener, "fmi{{ major }}DoStep at %.9g s: an output is no finite number and is given as 0: reset the FMU, and look for inputs far out of their range",
            point);
    } else {
        /* every period was decided */
    }
    instance->state.time = point + size;
    return (code == {{ NAME }}_OK) ? OK : ERROR;
}

/* Tell of a value reference that a function cannot serve. */
static int wrong_reference(const instance_t *instance, const char *function, unsigned int reference)
{
    tell(&instance->listener, "%s: value reference %u: %s; inputs and outputs have %u to %u, as modelDescription.xml says",
        function, reference, (reference < FIRST) ? "the time is set by the steps alone" : "no such variable",
        FIRST, FIRST + VARIABLES - 1U);
    return ERROR;
}

/* Outputs may be set while initialising only; nothing reads what was set. */
static int set_values(instance_t *instance, const char *function, const unsigned int *references, size_t count,
    const double *values)
{
    for (size_t i = 0; i < count; i++) {
        if (references[i] < FIRST || references[i] - FIRST >= VARIABLES) {
            return wrong_reference(instance, function, references[i]);
        }
        instance->state.values[references[i] - FIRST] = values[i];
    }
    return OK;
}

static int get_values(const instance_t *instance, const char *function, const unsigned int *references, size_t count,
    double *values)
{
    for (size_t i = 0; i < count; i++) {
        if (references[i] < FIRST) {
            values[i] = instance->state.time;
        } else if (references[i] - FIRST < VARIABLES) {
            values[i] = instance->state.values[references[i] - FIRST];
        } else {
            return wrong_reference(instance, function, references[i]);
        }
    }
    return OK;
}

/* Make room for a state where there is none. */
static int state_room(const instance_t *instance, void **state)
{
    if (*state == NULL) {
        *state = malloc(sizeof(state_t));
    }
    if (*state == NULL) {
        tell(&instance->listener, "state of %lu bytes: no memory is left", (unsigned long)sizeof(state_t));
        return ERROR;
    }
    return OK;
}

static int get_state(const instance_t *instance, void **state)
{
    const int status = state_room(instance, state);

    if (status == OK) {
        memcpy(*state, &instance->state, sizeof instance->state);
    }
    return status;
}

static int set_state(instance_t *instance, const void *state)
{
    memcpy(&instance->state, state, sizeof instance->state);
    return OK;
}

static int free_state(void **state)
{
    free(*state);
    *state = NULL;
    return OK;
}

static int wrong_size(const instance_t *instance, const char *function, size_t size)
{
    tell(&instance->listener, "%s: %lu bytes: a state of this FMU has %lu, as fmi{{ major }}Serialized{% if major == "2" %}FMUstate{% else %}FMUState{% endif %}Size says",
        function, (unsigned long)size, (unsigned long)sizeof(state_t));
    return ERROR;
}

static int serialize(const instance_t *instance, const char *function, const void *state, void *bytes, size_t size)
{
    if (size != sizeof(state_t)) {
        return wrong_size(instance, function, size);
    }
    memcpy(bytes, state, size);
    return OK;
}

static int deserialize(const instance_t *instance, const char *function, const void *bytes, size_t size, void **state)
{
    int status = OK;

    if (size != sizeof(state_t)) {
        return wrong_size(instance, function, size);
    }
    status = state_room(instance, state);
    if (status == OK) {
        memcpy(*state, bytes, size);
    }
    return status;
}

static int not_offered(const instance_t *instance, const char *function)
{
    tell(&instance->listener, "%s: {{ reason }}", function);
    return ERROR;
}
