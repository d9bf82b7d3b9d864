"""The first run, in Python: form a hemisphere, read the result, ask whether to believe it."""

import quasiform as qf

result = qf.solve(qf.forming("hemisphere", travel=10))

# what happened
print(result.status, f"at {result.states[-1].travel:g} mm")
print(f"punch force {result.force:.1f} N")
print("draw-in, mm:", {edge: round(inward, 2) for edge, inward in result.draw_in.items()})

# whether to believe it
print("certified:", bool(result.certified), *result.certified.reasons)
print("estimated errors:", {name: f"{error:.2g}" for name, error in result.estimate.items()})
doubts = {why: f"{flag.mean():.1%}" for why, flag in result.sheet.doubts().items()}
print("doubtful triangles:", doubts)
