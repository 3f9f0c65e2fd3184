"""Wrong or jumping clocks: every verb runs under libfaketime. Only reports contain times, and no lock, file name or
order may depend on the clock."""

import threading

import verbs
from common import Row, in_turn, unpacked

#: Clock settings in libfaketime's syntax; the last two jump during the work.
CLOCKS = ("@1970-01-01 00:00:01", "@2038-01-19 03:14:06", "-20y", "+20y", ("+0", "-3d"), ("+0", "+400d"))


def run_part(site, seconds):
    row = Row("clock jumps")
    folder = unpacked(site, row, "libfaketime")
    if folder is None:
        return row
    library = next(folder.glob("usr/lib/*/faketime/libfaketime.so.1"), None)
    if library is None:
        site.skip(row, "Debian's libfaketime has no libfaketime.so.1")
        return row
    inputs, all_verbs = verbs.learned(site)
    cases = [(verb, clock) for clock in CLOCKS for verb in all_verbs if verb.name != "study"]
    site.random.shuffle(cases)
    places = [verbs.Workplace(site, f"clock{number}", inputs) for number in range(site.workers)]

    def jump(worker, case):
        verb, clock = case
        place = places[worker]
        place.fresh(verb)
        file = place.folder / "clock"
        first, *later = [clock] if isinstance(clock, str) else clock
        file.write_text(first + "\n")
        timers = [threading.Timer(0.5 * verb.seconds, file.write_text, [then + "\n"]) for then in later]
        for timer in timers:
            timer.start()
        # The monotonic clock isn't faked, because the kernel's doesn't jump either.
        env = {"LD_PRELOAD": str(library), "FAKETIME_TIMESTAMP_FILE": str(file), "FAKETIME_NO_CACHE": "1",
               "FAKETIME_DONT_FAKE_MONOTONIC": "1", "DONT_FAKE_MONOTONIC": "1"}
        ended = place.run(verb, env=env)
        for timer in timers:
            timer.cancel()
        if ended.code != 0 and not ended.hung:
            site.find(row, "wrong", f"{verb.name} with the clock at {clock}: status {ended.code}: {ended.last()}")
        place.judge(row, verb, ended, f"clock at {clock}")

    total = in_turn(site, seconds, cases, jump)
    row.done = f"{total} of {len(cases)} commands with a clock that is wrong or jumps"
    return row
