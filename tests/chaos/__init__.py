"""Chaos: a building in lockstep whose controllers and listeners are killed, frozen, restarted and flooded at random.

`python -m chaos --seconds 120 --seed 6`, with `tests` on the path; `make chaos SECONDS=120 SEED=6`. What everybody sent
and heard is written down as it happens, and judged afterwards from that alone (`invariants`), by a second account of
who ruled what (`account`) and by a quiet run of the same commands (`replay`).
"""
