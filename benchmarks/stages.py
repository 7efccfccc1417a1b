"""What a long benchmark says while it runs."""

import time


class Progress:
    """Says what is being done, after how long, and how long all of it may take."""

    def __init__(self, stages, end="\n"):
        self.stages, self.end, self.done, self.began = stages, end, 0, time.perf_counter()

    def tell(self, what):
        elapsed = time.perf_counter() - self.began
        about = f" of about {elapsed * self.stages / self.done:.0f}" if self.done > 1 else ""
        print(f"[{elapsed:.0f}{about} s] {what}", end=self.end, flush=True)
        self.done += 1
