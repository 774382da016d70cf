/* Roll-outs of segments over lanes. A lane is one roll-out of one segment; a group is LANES lanes of one segment.
   It is compiled behind simd.h, the functions step, rotors and memory of the segment model with their constants, and the
   sizes PARAMETERS, NUISANCES and MEMORY. Arrays of a group are (rows, groups) vectors. */

#define STATES 12
#define CHANNELS 12
#define ROOM(size) ((size) ? (size) : 1)

/* Rows of the series of a step, in the order of step's inputs. */
enum { ATTITUDE, RATE = ATTITUDE + 9, VOLTAGE = RATE + 3, TIME, SHIFT, DISTURBANCE, SERIES = DISTURBANCE + 6 };

INLINE void load(int rows, long groups, const V *from, V *to) {
    for (int i = 0; i < rows; ++i) to[i] = from[i * groups];
}

/* The command of each lane `whole` + `share` steps before step k of `count`, between the first and the last one. */
INLINE void delayed(const double *command, long count, long k, const long *whole, V share, V *out) {
    for (int l = 0; l < LANES; ++l) {
        long now = k - whole[l], before;
        now = now < 0 ? 0 : now < count ? now : count - 1;
        before = now ? now - 1 : 0;
        for (int i = 0; i < 4; ++i)
            out[i][l] = share[l] ? (1.0 - share[l]) * command[4 * now + i] + share[l] * command[4 * before + i]
                                 : command[4 * now + i];
    }
}

/* command (segments, before + steps, 4); whole, share: its delay in steps. series (segments, steps, SERIES).
   x0 (segments, STATES, groups), states (segments, MEMORY, groups), nuisances (segments, NUISANCES, groups).
   added (steps / per_bin, 6, groups): disturbance in addition to that of the series, or 0.
   predicted (segments, steps, CHANNELS, groups). */
void roll_out(long segments, long groups, long before, long steps, long per_bin, const double *command,
              const long *whole, const V *share, const double *series, const V *x0, const V *theta, const V *states,
              const V *nuisances, const V *added, V *predicted) {
    for (long s = 0; s < segments; ++s, command += 4 * (before + steps), series += SERIES * steps) {
        for (long g = 0; g < groups; ++g) {
            V body[STATES], thrust[4] = {}, z[ROOM(PARAMETERS)], own[ROOM(MEMORY)], nuisance[NUISANCES], sent[4];
            V body_after[STATES], thrust_after[4], own_after[ROOM(MEMORY)], out[CHANNELS], input[SERIES];
            V of_step[STEP_CONSTANTS], of_rotors[ROTORS_CONSTANTS];
            load(STATES, groups, x0 + s * STATES * groups + g, body);
            load(PARAMETERS, groups, theta + g, z);
            load(MEMORY, groups, states + s * MEMORY * groups + g, own);
            load(NUISANCES, groups, nuisances + s * NUISANCES * groups + g, nuisance);
            step_constants(z, nuisance, of_step);
            rotors_constants(z, of_rotors);
            for (long k = 0; k < before; ++k) {
                delayed(command, before + steps, k, whole + g * LANES, share[g], sent);
                V settled[4];
                if (k == 0) {
                    rotors(thrust, z, sent, thrust_after, settled, of_rotors);
                    memcpy(thrust, settled, sizeof thrust);
                }
                rotors(thrust, z, sent, thrust_after, settled, of_rotors);
                memcpy(thrust, thrust_after, sizeof thrust);
            }
            for (long k = 0; k < steps; ++k) {
                delayed(command, before + steps, before + k, whole + g * LANES, share[g], sent);
                for (int i = 0; i < SERIES; ++i) input[i] = splat(series[SERIES * k + i]);
                if (added)
                    for (int i = 0; i < 6; ++i) input[DISTURBANCE + i] += added[(k / per_bin * 6 + i) * groups + g];
                step(body, thrust, z, own, nuisance, input + DISTURBANCE, sent, input + ATTITUDE, input + RATE,
                     input + VOLTAGE, input + TIME, input + SHIFT, body_after, thrust_after, own_after, out, of_step);
                for (int i = 0; i < CHANNELS; ++i)
                    predicted[((s * steps + k) * CHANNELS + i) * groups + g] = out[i];
                memcpy(body, body_after, sizeof body);
                memcpy(thrust, thrust_after, sizeof thrust);
                memcpy(own, own_after, sizeof own);
            }
        }
    }
}

/* States of the effects along measured paths (flights, samples, STATES), every `dt` s: (flights, samples, MEMORY,
   groups). They start at rest; the midpoint rule integrates them. */
void along_paths(long flights, long groups, long samples, double dt, const V *theta, const double *path, V *states) {
    for (long f = 0; f < flights; ++f, path += STATES * samples) {
        for (long g = 0; g < groups; ++g) {
            V body[STATES], z[ROOM(PARAMETERS)], own[ROOM(MEMORY)] = {}, half[ROOM(MEMORY)], rates[ROOM(MEMORY)];
            V acceleration[3] = {}, rest[ROOM(MEMORY)], of_memory[MEMORY_CONSTANTS];
            load(PARAMETERS, groups, theta + g, z);
            memory_constants(z, of_memory);
            for (int i = 0; i < STATES; ++i) body[i] = splat(path[i]);
            memory(body, z, own, acceleration, rates, rest, of_memory);
            memcpy(own, rest, sizeof own);
            for (long k = 0; k < samples; ++k) {
                const double *now = path + STATES * k, *next = k + 1 < samples ? now + STATES : now;
                for (int i = 0; i < MEMORY; ++i) states[((f * samples + k) * MEMORY + i) * groups + g] = own[i];
                for (int i = 0; i < 3; ++i) acceleration[i] = splat((next[3 + i] - now[3 + i]) / dt);
                for (int i = 0; i < STATES; ++i) body[i] = splat(now[i]);
                memory(body, z, own, acceleration, rates, rest, of_memory);
                for (int i = 0; i < MEMORY; ++i) half[i] = own[i] + 0.5 * dt * rates[i];
                for (int i = 0; i < STATES; ++i) body[i] = splat(0.5 * (now[i] + next[i]));
                memory(body, z, half, acceleration, rates, rest, of_memory);
                for (int i = 0; i < MEMORY; ++i) own[i] += dt * rates[i];
            }
        }
    }
}
