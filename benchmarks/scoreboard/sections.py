"""All sections of the page, in its order: real recordings, simulated and drawn ones, costs."""

from __future__ import annotations

from benchmarks.scoreboard.rows import Section

_REAL, _SIMULATED, _COST = "benchmarks.real", "benchmarks.simulated", "benchmarks.cost"

SECTIONS = (
    Section("cold", "Rooms of real maps", f"{_REAL}.cold", ("cold",), quick=True),
    Section(
        "plan-rooms",
        "Rooms of a whole build",
        f"{_REAL}.plan_rooms",
        ("logs", "rooms"),
        quick=True,
    ),
    Section("sessions", "Second sessions", f"{_REAL}.sessions", ("sessions",), quick=True),
    Section("parts", "Parts of one drive", f"{_REAL}.parts", ("logs", "truth")),
    Section("foreign", "Other buildings", f"{_REAL}.foreign", ("logs", "sessions")),
    Section(
        "verdicts",
        "Verdicts on real recordings",
        f"{_REAL}.verdicts",
        ("logs", "sessions", "truth"),
    ),
    Section(
        "trajectories",
        "Trajectories of real recordings",
        f"{_REAL}.trajectories",
        ("logs", "sessions", "truth"),
    ),
    Section(
        "recognition",
        "Recognition on real recordings",
        f"{_REAL}.recognition",
        ("logs", "truth"),
    ),
    Section("stability", "The same map again", f"{_REAL}.stability", ("logs", "rooms", "sessions")),
    Section("exports", "Exports, as their consumers read them", f"{_REAL}.exports", ("logs",)),
    Section("damaged", "Damaged inputs", f"{_REAL}.damaged", ("damaged",)),
    Section("plans", "Drawn plans", f"{_SIMULATED}.plans", ("rooms",), quick=True),
    Section("tours", "Whole maps of simulated tours", f"{_SIMULATED}.tours", ("rooms",)),
    Section("scale", "Large buildings, simulated", f"{_COST}.scale", ("rooms",)),
    Section("online", "Splitting on the way", f"{_SIMULATED}.online", ("rooms",), quick=True),
    Section(
        "revisits", "Loop closures, simulated", f"{_SIMULATED}.revisits", ("rooms",), quick=True
    ),
    Section("localization", "Localisation, simulated", f"{_SIMULATED}.localization", ("rooms",)),
    Section("unknown", "Unknown places, simulated", f"{_SIMULATED}.unknown"),
    Section("hard-logs", "Logs that are hard to map", f"{_SIMULATED}.hard_logs", ("logs", "truth")),
    Section("spoiled", "Verdicts on spoiled recordings", f"{_SIMULATED}.verdicts", ("rooms",)),
    Section("checking", "Rules of `check`", f"{_SIMULATED}.checking", quick=True),
    Section("comparison", "Maps compared", f"{_SIMULATED}.comparison", ("rooms",)),
    Section("keeping", "Maps kept and updated", f"{_SIMULATED}.keeping", ("logs", "truth")),
    Section("pairs", "Cost against KISS-ICP", f"{_COST}.pairs", ("logs",), timed=True),
    Section(
        "growth", "Cost as recordings grow", f"{_COST}.growth", ("logs", "damaged"), timed=True
    ),
    Section("using", "Cost of using it", f"{_COST}.using", ("cold",), quick=True, timed=True),
    Section("weight", "Weight of the tree", f"{_COST}.weight", quick=True),
    Section("gate", "The gate", f"{_COST}.gate", timed=True),
    Section("batches", "Batches", "benchmarks.batches.batch", timed=True),
)
