/* {{ title }} as a co-simulation FMU of FMI 3.0. The types are those of the standard. */
{% include "fmu/instance.c" %}

#include <stdbool.h>

typedef void *fmu_t;
typedef unsigned int reference_t;

EXPORT const char *fmi3GetVersion(void);
EXPORT int fmi3SetDebugLogging(fmu_t c, bool on, size_t count, const char *const *categories);
EXPORT fmu_t fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources,
    bool visible, bool logging, bool events, bool early, const reference_t *needed, size_t count,
    void *environment, log_t log, void (*update)(void));
EXPORT fmu_t fmi3InstantiateModelExchange(const char *name, const char *token, const char *resources,
    bool visible, bool logging, void *environment, log_t log);
EXPORT fmu_t fmi3InstantiateScheduledExecution(const char *name, const char *token, const char *resources,
    bool visible, bool logging, void *environment, log_t log,
    void (*update)(void *), void (*lock)(void), void (*unlock)(void));
EXPORT void fmi3FreeInstance(fmu_t c);
EXPORT int fmi3EnterInitializationMode(fmu_t c, bool defined, double tolerance, double start, bool stops,
    double stop);
EXPORT int fmi3ExitInitializationMode(fmu_t c);
EXPORT int fmi3EnterEventMode(fmu_t c);
EXPORT int fmi3EnterStepMode(fmu_t c);
EXPORT int fmi3EnterConfigurationMode(fmu_t c);
EXPORT int fmi3ExitConfigurationMode(fmu_t c);
EXPORT int fmi3Terminate(fmu_t c);
EXPORT int fmi3Reset(fmu_t c);
EXPORT int fmi3GetFloat64(fmu_t c, const reference_t *references, size_t count, double *values, size_t size);
EXPORT int fmi3SetFloat64(fmu_t c, const reference_t *references, size_t count, const double *values, size_t size);
EXPORT int fmi3GetFMUState(fmu_t c, void **state);
EXPORT int fmi3SetFMUState(fmu_t c, void *state);
EXPORT int fmi3FreeFMUState(fmu_t c, void **state);
EXPORT int fmi3SerializedFMUStateSize(fmu_t c, void *state, size_t *size);
EXPORT int fmi3SerializeFMUState(fmu_t c, void *state, unsigned char *bytes, size_t size);
EXPORT int fmi3DeserializeFMUState(fmu_t c, const unsigned char *bytes, size_t size, void **state);
EXPORT int fmi3DoStep(fmu_t c, double point, double size, bool no_return, bool *event, bool *ends, bool *early,
    double *reached);
{% for function, parameters in unsupported.items() %}
EXPORT int {{ function }}(fmu_t c{% if parameters %}, {{ parameters|map("join", "")|join(", ") }}{% endif %});
{% endfor %}

static int wrong_count(const instance_t *instance, const char *function, size_t count, size_t size)
{
    tell(&instance->listener, "%s: %lu value references and %lu values: give a value for each",
        function, (unsigned long)count, (unsigned long)size);
    return ERROR;
}

const char *fmi3GetVersion(void)
{
    return "3.0";
}

int fmi3SetDebugLogging(fmu_t c, bool on, size_t count, const char *const *categories)
{
    (void)c;
    (void)on;
    (void)count;
    (void)categories;
    return OK;
}

fmu_t fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources,
    bool visible, bool logging, bool events, bool early, const reference_t *needed, size_t count,
    void *environment, log_t log, void (*update)(void))
{
    const listener_t listener = listener_of(log, environment, name);

    (void)resources;
    (void)visible;
    (void)logging; /* of debugging; errors are always told */
    (void)events;
    (void)early;
    (void)needed;
    (void)count;
    (void)update;
    return instantiate(token, &listener);
}

fmu_t fmi3InstantiateModelExchange(const char *name, const char *token, const char *resources,
    bool visible, bool logging, void *environment, log_t log)
{
    const listener_t listener = listener_of(log, environment, name);

    (void)token;
    (void)resources;
    (void)visible;
    (void)logging;
    tell(&listener, "fmi3InstantiateModelExchange: this FMU is for co-simulation: call fmi3InstantiateCoSimulation");
    return NULL;
}

fmu_t fmi3InstantiateScheduledExecution(const char *name, const char *token, const char *resources,
    bool visible, bool logging, void *environment, log_t log,
    void (*update)(void *), void (*lock)(void), void (*unlock)(void))
{
    const listener_t listener = listener_of(log, environment, name);

    (void)token;
    (void)resources;
    (void)visible;
    (void)logging;
    (void)update;
    (void)lock;
    (void)unlock;
    tell(&listener, "fmi3InstantiateScheduledExecution: this FMU is for co-simulation: call fmi3InstantiateCoSimulation");
    return NULL;
}

void fmi3FreeInstance(fmu_t c)
{
    free(c);
}

int fmi3EnterInitializationMode(fmu_t c, bool defined, double tolerance, double start, bool stops, double stop)
{
    (void)defined;
    (void)tolerance;
    (void)stops;
    (void)stop;
    ((instance_t *)c)->state.time = start;
    return OK;
}

{% for function in ("ExitInitializationMode", "EnterEventMode", "EnterStepMode", "Terminate") %}
int fmi3{{ function }}(fmu_t c)
{
    (void)c;
    return OK;
}

{% endfor %}
{% for function in ("EnterConfigurationMode", "ExitConfigurationMode") %}
int fmi3{{ function }}(fmu_t c)
{
    return not_offered((const instance_t *)c, "fmi3{{ function }}");
}

{% endfor %}
int fmi3Reset(fmu_t c)
{
    begin((instance_t *)c);
    return OK;
}

int fmi3GetFloat64(fmu_t c, const reference_t *references, size_t count, double *values, size_t size)
{
    return (size == count) ? get_values((const instance_t *)c, "fmi3GetFloat64", references, count, values)
        : wrong_count((const instance_t *)c, "fmi3GetFloat64", count, size);
}

int fmi3SetFloat64(fmu_t c, const reference_t *references, size_t count, const double *values, size_t size)
{
    return (size == count) ? set_values((instance_t *)c, "fmi3SetFloat64", references, count, values)
        : wrong_count((const instance_t *)c, "fmi3SetFloat64", count, size);
}

int fmi3GetFMUState(fmu_t c, void **state)
{
    return get_state((const instance_t *)c, state);
}

int fmi3SetFMUState(fmu_t c, void *state)
{
    return set_state((instance_t *)c, state);
}

int fmi3FreeFMUState(fmu_t c, void **state)
{
    (void)c;
    return free_state(state);
}

int fmi3SerializedFMUStateSize(fmu_t c, void *state, size_t *size)
{
    (void)c;
    (void)state;
    *size = sizeof(state_t);
    return OK;
}

int fmi3SerializeFMUState(fmu_t c, void *state, unsigned char *bytes, size_t size)
{
    return serialize((const instance_t *)c, "fmi3SerializeFMUState", state, bytes, size);
}

int fmi3DeserializeFMUState(fmu_t c, const unsigned char *bytes, size_t size, void **state)
{
    return deserialize((const instance_t *)c, "fmi3DeserializeFMUState", bytes, size, state);
}

int fmi3DoStep(fmu_t c, double point, double size, bool no_return, bool *event, bool *ends, bool *early,
    double *reached)
{
    const int status = do_step((instance_t *)c, point, size);

    (void)no_return;
    *event = false;
    *ends = false;
    *early = false;
    *reached = (status == OK) ? point + size : point;
    return status;
}

{% for function, parameters in unsupported.items() %}
int {{ function }}(fmu_t c{% if parameters %}, {{ parameters|map("join", "")|join(", ") }}{% endif %})
{
{% for kind, parameter in parameters %}
    (void){{ parameter }};
{% endfor %}
    return not_offered((const instance_t *)c, "{{ function }}");
}

{% endfor %}
