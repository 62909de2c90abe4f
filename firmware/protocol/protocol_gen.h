/* Generated from protocol.toml by generate.py; do not edit. */
#ifndef TWINLINE_PROTOCOL_GEN_H
#define TWINLINE_PROTOCOL_GEN_H

#define PROTOCOL_NAME "twinline-board"
#define PROTOCOL_VERSION 1
#define PROTOCOL_HASH "63BD1270"

/* Longest line without its newline; a longer one is a bad line. */
#define PROTOCOL_LINE_BYTES 120
/* Requests are numbered modulo this. */
#define PROTOCOL_SEQUENCE_NUMBERS 65536
/* A command that comes again within so many others gets its old answer and does not run again. */
#define PROTOCOL_ANSWERS_KEPT 8
/* Events that EVENTS can send again. */
#define PROTOCOL_EVENTS_KEPT 32
/* Deadline that the host arms unless it is told another. */
#define PROTOCOL_HEARTBEAT_DEFAULT_MS 500
/* What 115200 baud carry with 20 % to spare. */
#define PROTOCOL_TELEMETRY_MAX_HZ 200
/* Telemetry tells positions in this fraction of a step; events and STATUS in whole steps. */
#define PROTOCOL_POSITION_FRACTION 16
/* Highest reading: the mean of a 12-bit converter times 16. */
#define PROTOCOL_ADC_FULL_SCALE 65520
/* Readings below this are out of the distance sensor's range: -4.2 V before the front end. */
#define PROTOCOL_ADC_CLIP_LOW 2736
/* Readings above this are out of the distance sensor's range: +4.2 V before the front end. */
#define PROTOCOL_ADC_CLIP_HIGH 62784
/* Readings below this are none that the distance sensor can cause. */
#define PROTOCOL_ADC_BROKEN_LOW 480
/* Readings above this are none that the distance sensor can cause. */
#define PROTOCOL_ADC_BROKEN_HIGH 65040
/* Clock in whole ticks of which every step is timed. */
#define PROTOCOL_TIMER_HZ 12000000
/* Distance from the switch at which homing the slide ends. */
#define PROTOCOL_HOME_CLEAR_STEPS 200
/* Rate at which the switch's edge is taken as zero. */
#define PROTOCOL_HOME_SLOW_MSTEPS_S 800000
/* Homing that has not met the switch after so many steps has failed. */
#define PROTOCOL_HOME_TRAVEL_STEPS 100000
/* A limit switch that closes further than this from where it first did since homing means lost steps. */
#define PROTOCOL_DRIFT_STEPS 3
/* A board that hangs starts again after this. */
#define PROTOCOL_WATCHDOG_MS 100

#define AXIS_CART_NUMBER 0
#define AXIS_CART_DEFAULT_RATE_MSTEPS_S 500000
#define AXIS_CART_DEFAULT_ACCELERATION_STEPS_S2 2000
#define AXIS_SLIDE_NUMBER 1
#define AXIS_SLIDE_DEFAULT_RATE_MSTEPS_S 4000000
#define AXIS_SLIDE_DEFAULT_ACCELERATION_STEPS_S2 40000

/* X(verb, needs session, runs each time it comes, number of arguments) */
#define PROTOCOL_VERBS(X) \
    X(HELLO, 0, 1, 0) \
    X(STATUS, 0, 1, 0) \
    X(PING, 0, 1, 0) \
    X(HB, 1, 1, 1) \
    X(LASER, 1, 0, 1) \
    X(SPEED, 1, 0, 3) \
    X(BOUNDS, 1, 0, 3) \
    X(MOVE, 1, 0, 2) \
    X(STOP, 1, 0, 0) \
    X(HOME, 1, 0, 1) \
    X(SCAN, 1, 0, 5) \
    X(RASTER, 1, 0, 6) \
    X(TELEM, 1, 0, 2) \
    X(EVENTS, 1, 1, 1) \
    X(RESET, 1, 0, 0)

/* X(verb, position of the argument, lowest, highest) */
#define PROTOCOL_ARGUMENTS(X) \
    X(HB, 0, 0, 2000) \
    X(LASER, 0, 0, 3) \
    X(SPEED, 0, 0, 1) \
    X(SPEED, 1, 1000, 20000000) \
    X(SPEED, 2, 100, 1000000) \
    X(BOUNDS, 0, 0, 1) \
    X(BOUNDS, 1, -10000000, 10000000) \
    X(BOUNDS, 2, -10000000, 10000000) \
    X(MOVE, 0, 0, 1) \
    X(MOVE, 1, -10000000, 10000000) \
    X(HOME, 0, 0, 1) \
    X(SCAN, 0, -10000000, 10000000) \
    X(SCAN, 1, -10000000, 10000000) \
    X(SCAN, 2, 1000, 20000000) \
    X(SCAN, 3, 0, 3333) \
    X(SCAN, 4, 0, 10000000) \
    X(RASTER, 0, -10000000, 10000000) \
    X(RASTER, 1, -10000000, 10000000) \
    X(RASTER, 2, 1, 10000000) \
    X(RASTER, 3, -10000000, 10000000) \
    X(RASTER, 4, -10000000, 10000000) \
    X(RASTER, 5, 1000, 20000000) \
    X(TELEM, 0, 0, 200) \
    X(TELEM, 1, 1, 4) \
    X(EVENTS, 0, 0, 4294967295u)

/* X(name, text on the wire) */
#define PROTOCOL_ERRORS(X) \
    X(UNKNOWN_VERB, "unknown-verb") \
    X(BAD_ARGUMENTS, "bad-arguments") \
    X(OUT_OF_RANGE, "out-of-range") \
    X(NO_SESSION, "no-session") \
    X(LATCHED, "latched") \
    X(NO_HEARTBEAT, "no-heartbeat") \
    X(BUSY, "busy") \
    X(LIMIT_ACTIVE, "limit-active") \
    X(NOT_HOMED, "not-homed") \
    X(E_STOP_ACTIVE, "e-stop-active")

/* X(name, text on the wire) */
#define PROTOCOL_EVENTS(X) \
    X(BOOT, "boot") \
    X(MOTION_END, "motion-end") \
    X(SCAN_START, "scan-start") \
    X(SCAN_END, "scan-end") \
    X(ROW_START, "row-start") \
    X(ROW_END, "row-end") \
    X(LASERS, "lasers") \
    X(LIMIT, "limit") \
    X(DRIFT, "drift") \
    X(E_STOP, "e-stop") \
    X(LATCH, "latch")

#define FLAG_LASER_1 (1u << 0)
#define FLAG_LASER_2 (1u << 1)
#define FLAG_CART_MOVING (1u << 2)
#define FLAG_SLIDE_MOVING (1u << 3)
#define FLAG_RUNNING (1u << 4)
#define FLAG_LIMIT_LOW (1u << 5)
#define FLAG_LIMIT_HIGH (1u << 6)
#define FLAG_E_STOP (1u << 7)
#define FLAG_LATCHED (1u << 8)
#define FLAG_HEARTBEAT (1u << 9)
#define FLAG_CART_KNOWN (1u << 10)
#define FLAG_SLIDE_KNOWN (1u << 11)
#define FLAG_ADC_CLIPPED (1u << 12)
#define FLAG_ADC_BROKEN (1u << 13)

/* How a movement ended. */
#define MOTION_END_DONE 0
#define MOTION_END_STOPPED 1
#define MOTION_END_LIMIT 2
#define MOTION_END_E_STOP 3
#define MOTION_END_HEARTBEAT 4
#define MOTION_END_WIRING 5
#define MOTION_END_HOME_FAILED 6

/* Why the board is latched. */
#define LATCH_NONE 0
#define LATCH_E_STOP 1
#define LATCH_HEARTBEAT 2
#define LATCH_WIRING 3

/* Why the board started. */
#define RESET_CAUSE_POWER 0
#define RESET_CAUSE_BUTTON 1
#define RESET_CAUSE_WATCHDOG 2
#define RESET_CAUSE_SOFTWARE 3

/* Why a line was not taken, as a word. */
#define BAD_LINE_FORM 0
#define BAD_LINE_LONG 1
#define BAD_LINE_CRC 2

#endif
