"""Links that a router refused are counted by what was wrong, and the rest of its output is passed on."""

import subprocess
import sys

REFUSED = """
import os
from agents.launch.refused_links import RefusedLinks
links = RefusedLinks(lambda line: os.write(2, (line + chr(10)).encode()))
for second in range(150):
    said = f"certificate expired: verification time {second} (UNIX), but certificate is not valid after 7 (x ago)"
    print(f"T WARN acc-0 zenoh_link_tls::unicast: invalid peer certificate: {said}. Hint: none", flush=True)
print("something else", flush=True)
links.close()
"""


def test_links_refused_for_one_reason_at_different_times_are_counted_together():
    done = subprocess.run([sys.executable, "-c", REFUSED], capture_output=True, text=True, timeout=60, check=True)
    told = "a link was refused: invalid peer certificate: certificate expired"
    assert done.stderr.splitlines() == [f"{told} (1 so far)", f"{told} (101 so far)"]
    assert done.stdout == "something else\n"
