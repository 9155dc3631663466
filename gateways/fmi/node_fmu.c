/* FMI 2.0 for co-simulation of a node: a client of `zenostat gateway fmi`.
 *
 * The instance connects to the gateway in fmi2EnterInitializationMode, which begins an episode, and disconnects in
 * fmi2Terminate, fmi2Reset and fmi2FreeInstance. `interface.h` has the sizes of one node's interface: OUTPUTS,
 * ACTUATORS, STEP_S, STEPS, GUID and START_ADDRESS.
 *
 * All messages have a header of two little-endian uint32, kind and length of the content; see `messages.py`.
 */

#ifndef _WIN32
#define _POSIX_C_SOURCE 200112L
#define _DARWIN_C_SOURCE
#endif

#include <errno.h>
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <winsock2.h>
#include <ws2tcpip.h>
#define EXPORT __declspec(dllexport)
#define poll WSAPoll
#define close_socket closesocket
#define END_OF_SENDING SD_SEND
#define SEND_FLAGS 0
typedef SOCKET Socket;
#define NO_SOCKET INVALID_SOCKET
#define process_id() 0
#else
#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>
#define EXPORT __attribute__((visibility("default")))
#define close_socket close
#define END_OF_SENDING SHUT_WR
#ifdef MSG_NOSIGNAL
#define SEND_FLAGS MSG_NOSIGNAL
#else
#define SEND_FLAGS 0
#endif
typedef int Socket;
#define NO_SOCKET (-1)
#define process_id() getpid()
#endif

#include "interface.h"

/* Types of FMI 2.0 */

typedef unsigned int ValueReference;
typedef int Boolean;
typedef const char *String;
typedef enum { OK, WARNING, DISCARD, ERROR_STATUS, FATAL, PENDING } Status;
typedef enum { DO_STEP_STATUS, PENDING_STATUS, LAST_SUCCESSFUL_TIME, TERMINATED } StatusKind;
typedef void (*Logger)(void *, String, Status, String, String, ...);
typedef struct {
    Logger logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*step_finished)(void *, Status);
    void *environment;
} Callbacks;

/* Messages; kinds and flags as in messages.py */

enum { OPEN = 1, STEP = 2, SAVE = 3, RESTORE = 4, DROP = 5, SAMPLE = 16, SAVED = 17, DROPPED = 18, WORKING = 19, FAILURE = 20 };
enum { TRUNCATED = 1 };

#define HEADER 8
#define CONNECT_MS 10000
#define SILENCE_MS 30000 /* the gateway sends WORKING every few seconds while it waits for the node */
#define END_MS 5000
#define MAX_TEXT 1024 /* longest text of an error */
#define ADDRESS 300
#define STEP_TOLERANCE 1e-6

typedef struct {
    double outputs[OUTPUTS + 1]; /* + 1: C has no arrays of size 0 */
    double inputs[ACTUATORS + 1];
    Boolean active[ACTUATORS + 1];
    uint32_t step; /* timesteps since the beginning of the episode */
    Boolean truncated;
} Values;

typedef struct {
    Values values;
    uint32_t snapshot;
    uint32_t connection; /* a snapshot ends with the connection that made it */
} State;

typedef enum { INSTANTIATED, CONNECTED, TERMINATED_STATE, FAILED } Phase;

typedef struct {
    Callbacks callbacks;
    char *name;
    Boolean is_logging;
    Phase phase;
    Values values;
    double start_time, stop_time;
    char address[ADDRESS];
    int seed;
    Socket socket;
    uint32_t connection; /* number of the present one */
    long process; /* that opened the socket: a fork of it must not use it */
} Instance;

static const double NOTHING = NAN;

/* Report a text. It is the format itself, with %% for %, since importers written in other languages ignore the rest. */
static Status report(Instance *instance, Status status, const char *format, ...) {
    char text[MAX_TEXT], escaped[2 * MAX_TEXT];
    const char *from = text;
    char *to = escaped;
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    while ((*to++ = *from) != '\0')
        if (*from++ == '%')
            *to++ = '%';
    if (instance->callbacks.logger != NULL && (instance->is_logging || status >= ERROR_STATUS))
        instance->callbacks.logger(
            instance->callbacks.environment, instance->name, status, status >= ERROR_STATUS ? "logStatusError" : "logAll", escaped
        );
    if (status >= ERROR_STATUS)
        instance->phase = FAILED;
    return status;
}

/* The connection */

static void set_blocking(Socket socket, int is_blocking) {
#ifdef _WIN32
    u_long mode = !is_blocking;
    ioctlsocket(socket, FIONBIO, &mode);
#else
    int flags = fcntl(socket, F_GETFL, 0);
    fcntl(socket, F_SETFL, is_blocking ? flags & ~O_NONBLOCK : flags | O_NONBLOCK);
#endif
}

static int ready(Socket socket, short events, int timeout_ms) {
    struct pollfd entry;
    int count;
    entry.fd = socket;
    entry.events = events;
    entry.revents = 0;
    do
        count = poll(&entry, 1, timeout_ms);
    while (count < 0 && errno == EINTR);
    return count > 0;
}

/* End the connection, and wait until the gateway has: then the actuators are free for the next one. */
static void disconnect(Instance *instance) {
    char rest[64];
    if (instance->socket == NO_SOCKET)
        return;
    if (instance->process == process_id()) {
        shutdown(instance->socket, END_OF_SENDING);
        while (ready(instance->socket, POLLIN, END_MS) && recv(instance->socket, rest, sizeof rest, 0) > 0)
            ;
    }
    close_socket(instance->socket);
    instance->socket = NO_SOCKET;
}

/* Connect to one address, with a timeout; NO_SOCKET if nobody accepts there. */
static Socket connect_to(const struct addrinfo *target) {
    int error = 0, yes = 1;
    socklen_t size = sizeof error;
    Socket made = socket(target->ai_family, target->ai_socktype, target->ai_protocol);
    if (made == NO_SOCKET)
        return NO_SOCKET;
#ifndef _WIN32
    fcntl(made, F_SETFD, FD_CLOEXEC);
#endif
#ifdef SO_NOSIGPIPE
    setsockopt(made, SOL_SOCKET, SO_NOSIGPIPE, &yes, sizeof yes);
#endif
    set_blocking(made, 0);
    if (connect(made, target->ai_addr, (socklen_t)target->ai_addrlen) != 0 &&
        (!ready(made, POLLOUT, CONNECT_MS) || getsockopt(made, SOL_SOCKET, SO_ERROR, (char *)&error, &size) != 0 ||
         error != 0)) {
        close_socket(made);
        return NO_SOCKET;
    }
    set_blocking(made, 1);
    setsockopt(made, IPPROTO_TCP, TCP_NODELAY, (const char *)&yes, sizeof yes);
    return made;
}

static Status connect_gateway(Instance *instance) {
    char host[ADDRESS];
    char *port;
    struct addrinfo hints, *targets = NULL, *target;
    strcpy(host, instance->address);
    port = strrchr(host, ':');
    if (port == NULL || port == host || port[1] == '\0')
        return report(instance, ERROR_STATUS, "address '%s': expected HOST:PORT, such as " START_ADDRESS, host);
    *port++ = '\0';
    if (host[0] == '[' && port[-2] == ']') { /* IPv6 */
        port[-2] = '\0';
        memmove(host, host + 1, strlen(host));
    }
    memset(&hints, 0, sizeof hints);
    hints.ai_socktype = SOCK_STREAM;
    if (getaddrinfo(host, port, &hints, &targets) != 0)
        return report(instance, ERROR_STATUS, "address '%s': the host or the port is not known", instance->address);
    for (target = targets; target != NULL && instance->socket == NO_SOCKET; target = target->ai_next)
        instance->socket = connect_to(target);
    freeaddrinfo(targets);
    if (instance->socket == NO_SOCKET)
        return report(
            instance, ERROR_STATUS, "nobody listens at %s: start `zenostat gateway fmi NODE`, or set the parameter `address`",
            instance->address
        );
    instance->process = process_id();
    instance->connection++;
    return OK;
}

static int send_all(Socket socket, const char *bytes, size_t size) {
    while (size > 0) {
        long sent = (long)send(socket, bytes, (int)size, SEND_FLAGS);
        if (sent < 0 && errno == EINTR)
            continue;
        if (sent <= 0)
            return 0;
        bytes += sent;
        size -= (size_t)sent;
    }
    return 1;
}

static int receive_all(Socket socket, char *bytes, size_t size) {
    while (size > 0) {
        long received;
        if (!ready(socket, POLLIN, SILENCE_MS))
            return 0;
        received = (long)recv(socket, bytes, (int)size, 0);
        if (received < 0 && errno == EINTR)
            continue;
        if (received <= 0)
            return 0;
        bytes += received;
        size -= (size_t)received;
    }
    return 1;
}

static void put_uint32(char *bytes, uint32_t value) {
    int i;
    for (i = 0; i < 4; i++)
        bytes[i] = (char)(value >> (8 * i) & 0xff);
}

static uint32_t get_uint32(const char *bytes) {
    uint32_t value = 0;
    int i;
    for (i = 0; i < 4; i++)
        value |= (uint32_t)(unsigned char)bytes[i] << (8 * i);
    return value;
}

static Status lost(Instance *instance) {
    disconnect(instance);
    return report(instance, ERROR_STATUS, "the connection to the gateway at %s is lost", instance->address);
}

/* Send a request and read the answer of a kind; `content` is that of the request, and has room for that of a sample. */
static Status ask(Instance *instance, uint32_t request, char *content, uint32_t size, uint32_t expected) {
    char header[HEADER], text[MAX_TEXT];
    uint32_t kind, length;
    if (instance->process != process_id()) {
        disconnect(instance);
        return report(instance, ERROR_STATUS, "the FMU was copied by a fork; instantiate another one, or use its FMU states");
    }
    put_uint32(header, request);
    put_uint32(header + 4, size);
    if (!send_all(instance->socket, header, HEADER) || !send_all(instance->socket, content, size))
        return lost(instance);
    for (;;) {
        if (!receive_all(instance->socket, header, HEADER))
            return lost(instance);
        kind = get_uint32(header);
        length = get_uint32(header + 4);
        if (kind == WORKING && length == 0)
            continue;
        if (kind == FAILURE && length < MAX_TEXT) {
            if (!receive_all(instance->socket, text, length))
                return lost(instance);
            text[length] = '\0';
            return report(instance, ERROR_STATUS, "%s", text);
        }
        if (kind != expected || length != (kind == SAMPLE ? 8 + 8 * OUTPUTS : kind == SAVED ? 4 : 0) ||
            !receive_all(instance->socket, content, length))
            return lost(instance);
        return OK;
    }
}

static Status ask_sample(Instance *instance, uint32_t request, char *content, uint32_t size) {
    Status status = ask(instance, request, content, size, SAMPLE);
    if (status != OK)
        return status;
    instance->values.truncated = (get_uint32(content) & TRUNCATED) != 0;
    instance->values.step = get_uint32(content + 4);
    memcpy(instance->values.outputs, content + 8, 8 * OUTPUTS);
    return OK;
}

/* The life of an instance */

static const double LOWS[] = LOW_VALUES, HIGHS[] = HIGH_VALUES, STARTS[] = START_VALUES;

static void set_defaults(Instance *instance) {
    int i;
    memset(&instance->values, 0, sizeof instance->values);
    for (i = 0; i < OUTPUTS; i++)
        instance->values.outputs[i] = NOTHING;
    memcpy(instance->values.inputs, STARTS, sizeof STARTS);
    strcpy(instance->address, START_ADDRESS);
    instance->seed = -1;
    instance->start_time = 0.0;
    instance->stop_time = INFINITY;
    instance->phase = INSTANTIATED;
}

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }

EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

EXPORT void *fmi2Instantiate(
    String name, int type, String guid, String resources, const Callbacks *callbacks, Boolean visible, Boolean is_logging
) {
    Instance *instance;
    (void)resources;
    (void)visible;
    if (callbacks == NULL || name == NULL || (instance = calloc(1, sizeof *instance)) == NULL)
        return NULL;
    instance->callbacks = *callbacks;
    instance->is_logging = is_logging;
    instance->socket = NO_SOCKET;
    instance->name = malloc(strlen(name) + 1);
    if (instance->name == NULL) {
        free(instance);
        return NULL;
    }
    strcpy(instance->name, name);
    set_defaults(instance);
#ifdef _WIN32
    {
        WSADATA data;
        WSAStartup(MAKEWORD(2, 2), &data);
    }
#endif
    if (type != 1)
        report(instance, ERROR_STATUS, "this FMU is for co-simulation");
    else if (guid == NULL || strcmp(guid, GUID) != 0)
        report(instance, ERROR_STATUS, "the GUID is not that of this FMU: its binary belongs to another model description");
    if (instance->phase == FAILED) {
        free(instance->name);
        free(instance);
        return NULL;
    }
    return instance;
}

EXPORT void fmi2FreeInstance(void *component) {
    Instance *instance = component;
    if (instance == NULL)
        return;
    disconnect(instance);
#ifdef _WIN32
    WSACleanup();
#endif
    free(instance->name);
    free(instance);
}

EXPORT Status fmi2SetDebugLogging(void *component, Boolean is_logging, size_t count, const String categories[]) {
    (void)count;
    (void)categories;
    ((Instance *)component)->is_logging = is_logging;
    return OK;
}

EXPORT Status fmi2SetupExperiment(
    void *component, Boolean has_tolerance, double tolerance, double start_time, Boolean has_stop_time, double stop_time
) {
    (void)has_tolerance;
    (void)tolerance;
    ((Instance *)component)->start_time = start_time;
    ((Instance *)component)->stop_time = has_stop_time ? stop_time : INFINITY;
    return OK;
}

EXPORT Status fmi2EnterInitializationMode(void *component) {
    Instance *instance = component;
    char content[8 + 8 * OUTPUTS + sizeof GUID];
    if (instance->phase != INSTANTIATED)
        return report(instance, ERROR_STATUS, "fmi2EnterInitializationMode: the FMU is initialized already, or has failed");
    if (connect_gateway(instance) != OK)
        return ERROR_STATUS;
    instance->phase = CONNECTED;
    put_uint32(content, (uint32_t)instance->seed);
    memcpy(content + 4, GUID, sizeof GUID - 1);
    return ask_sample(instance, OPEN, content, 4 + sizeof GUID - 1);
}

static Status check_connected(Instance *instance, const char *function) {
    if (instance->phase == CONNECTED)
        return OK;
    return report(
        instance, ERROR_STATUS, "%s: %s", function,
        instance->phase == FAILED ? "the FMU has failed before; reset it" : "the FMU is not initialized"
    );
}

EXPORT Status fmi2ExitInitializationMode(void *component) { return check_connected(component, "fmi2ExitInitializationMode"); }

EXPORT Status fmi2Terminate(void *component) {
    Instance *instance = component;
    disconnect(instance);
    instance->phase = TERMINATED_STATE;
    return OK;
}

EXPORT Status fmi2Reset(void *component) {
    disconnect(component);
    set_defaults(component);
    return OK;
}

EXPORT Status fmi2DoStep(void *component, double time, double size, Boolean keeps_no_state) {
    Instance *instance = component;
    Values *values = &instance->values;
    char content[8 + 8 * (OUTPUTS + ACTUATORS)];
    double steps = floor(size / STEP_S + 0.5), expected = instance->start_time + values->step * STEP_S, value;
    int i;
    (void)keeps_no_state;
    if (check_connected(instance, "fmi2DoStep") != OK)
        return ERROR_STATUS;
    if (!(fabs(size - steps * STEP_S) <= STEP_TOLERANCE * STEP_S) || steps < 1)
        return report(
            instance, ERROR_STATUS, "fmi2DoStep: a step of %.9g s; expected a multiple of the timestep of %.9g s", size, STEP_S
        );
    if (!(fabs(time - expected) <= STEP_TOLERANCE * STEP_S + 1e-9 * fabs(time)))
        return report(instance, ERROR_STATUS, "fmi2DoStep: a step from %.9g s; the FMU is at %.9g s", time, expected);
    if (steps > (double)(STEPS - values->step))
        return report(
            instance, ERROR_STATUS, "fmi2DoStep: a step to %.9g s; the episode ends at %.9g s", time + size,
            instance->start_time + STEPS * STEP_S
        );
    if (time + size > instance->stop_time + STEP_TOLERANCE * STEP_S + 1e-9 * fabs(instance->stop_time))
        return report(
            instance, ERROR_STATUS, "fmi2DoStep: a step to %.9g s; the stop time of the experiment is %.9g s", time + size,
            instance->stop_time
        );
    put_uint32(content, (uint32_t)steps);
    for (i = 0; i < ACTUATORS; i++) {
        value = values->active[i] ? values->inputs[i] : NOTHING;
        memcpy(content + 4 + 8 * i, &value, 8);
    }
    return ask_sample(instance, STEP, content, 4 + 8 * ACTUATORS);
}

EXPORT Status fmi2CancelStep(void *component) { return report(component, ERROR_STATUS, "fmi2CancelStep: steps are not asynchronous"); }

/* Values. References: outputs from 0, then inputs; Booleans, the integer and the string have references of their own. */

static Status unknown(Instance *instance, const char *function, ValueReference reference) {
    return report(instance, ERROR_STATUS, "%s: no variable has the value reference %u", function, reference);
}

EXPORT Status fmi2GetReal(void *component, const ValueReference references[], size_t count, double values[]) {
    Instance *instance = component;
    size_t i;
    for (i = 0; i < count; i++) {
        if (references[i] < OUTPUTS)
            values[i] = instance->values.outputs[references[i]];
        else if (references[i] - OUTPUTS < ACTUATORS)
            values[i] = instance->values.inputs[references[i] - OUTPUTS];
        else
            return unknown(instance, "fmi2GetReal", references[i]);
    }
    return OK;
}

EXPORT Status fmi2SetReal(void *component, const ValueReference references[], size_t count, const double values[]) {
    Instance *instance = component;
    size_t i;
    for (i = 0; i < count; i++) {
        ValueReference index = references[i] - OUTPUTS;
        if (references[i] < OUTPUTS || index >= ACTUATORS)
            return report(instance, ERROR_STATUS, "fmi2SetReal: the value reference %u is not that of an input", references[i]);
        if (!(values[i] >= LOWS[index] && values[i] <= HIGHS[index]))
            return report(
                instance, ERROR_STATUS, "fmi2SetReal: %.9g is not within %.9g and %.9g, the bounds of input %u", values[i],
                LOWS[index], HIGHS[index], index
            );
        instance->values.inputs[index] = values[i];
    }
    return OK;
}

EXPORT Status fmi2GetBoolean(void *component, const ValueReference references[], size_t count, Boolean values[]) {
    Instance *instance = component;
    size_t i;
    for (i = 0; i < count; i++) {
        if (references[i] >= ACTUATORS)
            return unknown(instance, "fmi2GetBoolean", references[i]);
        values[i] = instance->values.active[references[i]];
    }
    return OK;
}

EXPORT Status fmi2SetBoolean(void *component, const ValueReference references[], size_t count, const Boolean values[]) {
    Instance *instance = component;
    size_t i;
    for (i = 0; i < count; i++) {
        if (references[i] >= ACTUATORS)
            return unknown(instance, "fmi2SetBoolean", references[i]);
        instance->values.active[references[i]] = values[i] != 0;
    }
    return OK;
}

EXPORT Status fmi2GetInteger(void *component, const ValueReference references[], size_t count, int values[]) {
    size_t i;
    for (i = 0; i < count; i++) {
        if (references[i] != 0)
            return unknown(component, "fmi2GetInteger", references[i]);
        values[i] = ((Instance *)component)->seed;
    }
    return OK;
}

EXPORT Status fmi2SetInteger(void *component, const ValueReference references[], size_t count, const int values[]) {
    Instance *instance = component;
    size_t i;
    for (i = 0; i < count; i++) {
        if (references[i] != 0)
            return unknown(instance, "fmi2SetInteger", references[i]);
        if (instance->phase != INSTANTIATED)
            return report(instance, ERROR_STATUS, "fmi2SetInteger: `seed` can be set before the initialization only");
        if (values[i] < -1)
            return report(instance, ERROR_STATUS, "fmi2SetInteger: seed %d; expected -1 (none) or more", values[i]);
        instance->seed = values[i];
    }
    return OK;
}

EXPORT Status fmi2GetString(void *component, const ValueReference references[], size_t count, String values[]) {
    size_t i;
    for (i = 0; i < count; i++) {
        if (references[i] != 0)
            return unknown(component, "fmi2GetString", references[i]);
        values[i] = ((Instance *)component)->address;
    }
    return OK;
}

EXPORT Status fmi2SetString(void *component, const ValueReference references[], size_t count, const String values[]) {
    Instance *instance = component;
    size_t i;
    for (i = 0; i < count; i++) {
        if (references[i] != 0)
            return unknown(instance, "fmi2SetString", references[i]);
        if (instance->phase != INSTANTIATED)
            return report(instance, ERROR_STATUS, "fmi2SetString: `address` can be set before the initialization only");
        if (values[i] == NULL || strlen(values[i]) >= ADDRESS)
            return report(instance, ERROR_STATUS, "fmi2SetString: `address` can have up to %d characters", ADDRESS - 1);
        strcpy(instance->address, values[i]);
    }
    return OK;
}

/* FMU states: snapshots of the node */

EXPORT Status fmi2GetFMUstate(void *component, void **pointer) {
    Instance *instance = component;
    State *state = *pointer;
    char content[8 + 8 * OUTPUTS];
    if (check_connected(instance, "fmi2GetFMUstate") != OK)
        return ERROR_STATUS;
    if (state != NULL && state->connection == instance->connection) { /* its memory is used again */
        put_uint32(content, state->snapshot);
        if (ask(instance, DROP, content, 4, DROPPED) != OK)
            return ERROR_STATUS;
    }
    if (state == NULL && (state = malloc(sizeof *state)) == NULL)
        return report(instance, ERROR_STATUS, "fmi2GetFMUstate: no memory");
    if (ask(instance, SAVE, content, 0, SAVED) != OK) {
        if (*pointer == NULL)
            free(state);
        return ERROR_STATUS;
    }
    state->values = instance->values;
    state->snapshot = get_uint32(content);
    state->connection = instance->connection;
    *pointer = state;
    return OK;
}

EXPORT Status fmi2SetFMUstate(void *component, void *pointer) {
    Instance *instance = component;
    State *state = pointer;
    char content[8 + 8 * OUTPUTS];
    if (check_connected(instance, "fmi2SetFMUstate") != OK)
        return ERROR_STATUS;
    if (state == NULL || state->connection != instance->connection)
        return report(instance, ERROR_STATUS, "fmi2SetFMUstate: the FMU was reset after this state");
    put_uint32(content, state->snapshot);
    if (ask_sample(instance, RESTORE, content, 4) != OK)
        return ERROR_STATUS;
    instance->values = state->values; /* also the outputs: those of a step of several timesteps have means */
    return OK;
}

EXPORT Status fmi2FreeFMUstate(void *component, void **pointer) {
    Instance *instance = component;
    State *state = *pointer;
    char content[8 + 8 * OUTPUTS];
    Status status = OK;
    if (state != NULL && instance->phase == CONNECTED && state->connection == instance->connection) {
        put_uint32(content, state->snapshot);
        status = ask(instance, DROP, content, 4, DROPPED);
    }
    free(state);
    *pointer = NULL;
    return status;
}

static Status unsupported(void *component, const char *function) {
    return report(component, ERROR_STATUS, "%s is not supported, as the model description says", function);
}

EXPORT Status fmi2SerializedFMUstateSize(void *component, void *state, size_t *size) {
    (void)state;
    (void)size;
    return unsupported(component, "fmi2SerializedFMUstateSize");
}

EXPORT Status fmi2SerializeFMUstate(void *component, void *state, char bytes[], size_t size) {
    (void)state;
    (void)bytes;
    (void)size;
    return unsupported(component, "fmi2SerializeFMUstate");
}

EXPORT Status fmi2DeSerializeFMUstate(void *component, const char bytes[], size_t size, void **state) {
    (void)bytes;
    (void)size;
    (void)state;
    return unsupported(component, "fmi2DeSerializeFMUstate");
}

EXPORT Status fmi2GetDirectionalDerivative(
    void *component, const ValueReference unknowns[], size_t unknown_count, const ValueReference knowns[], size_t known_count,
    const double known[], double derivatives[]
) {
    (void)unknowns;
    (void)unknown_count;
    (void)knowns;
    (void)known_count;
    (void)known;
    (void)derivatives;
    return unsupported(component, "fmi2GetDirectionalDerivative");
}

EXPORT Status fmi2SetRealInputDerivatives(
    void *component, const ValueReference references[], size_t count, const int orders[], const double values[]
) {
    (void)references;
    (void)count;
    (void)orders;
    (void)values;
    return unsupported(component, "fmi2SetRealInputDerivatives");
}

EXPORT Status fmi2GetRealOutputDerivatives(
    void *component, const ValueReference references[], size_t count, const int orders[], double values[]
) {
    (void)references;
    (void)count;
    (void)orders;
    (void)values;
    return unsupported(component, "fmi2GetRealOutputDerivatives");
}

/* Status of the latest step */

EXPORT Status fmi2GetStatus(void *component, StatusKind kind, Status *value) {
    (void)component;
    if (kind != DO_STEP_STATUS)
        return DISCARD;
    *value = OK;
    return OK;
}

EXPORT Status fmi2GetRealStatus(void *component, StatusKind kind, double *value) {
    Instance *instance = component;
    if (kind != LAST_SUCCESSFUL_TIME)
        return DISCARD;
    *value = instance->start_time + instance->values.step * STEP_S;
    return OK;
}

EXPORT Status fmi2GetIntegerStatus(void *component, StatusKind kind, int *value) {
    (void)component;
    (void)kind;
    (void)value;
    return DISCARD;
}

EXPORT Status fmi2GetBooleanStatus(void *component, StatusKind kind, Boolean *value) {
    if (kind != TERMINATED)
        return DISCARD;
    *value = ((Instance *)component)->values.truncated;
    return OK;
}

EXPORT Status fmi2GetStringStatus(void *component, StatusKind kind, String *value) {
    (void)kind;
    (void)value;
    return report(component, DISCARD, "fmi2GetStringStatus: steps are not asynchronous");
}
