"""What a fleet tells others: web hook, mail, command, metrics, heartbeat, and the examples."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import re
from pathlib import Path

from tests.pipeline.notification.servers import Hook, hook
from tests.pipeline.notification.test_mail import serving
from tests.scenarios.command import ROOT, run_line
from tests.scenarios.covering import covers
from tests.scenarios.fleets import ScenarioFleet

SECRET = b"a secret of twenty-four."
HOOK = "/S3CRET?key=S3CRET"
EXAMPLES = (
    "cron/motor-leakage",
    "systemd/motor-leakage.service",
    "systemd/motor-leakage-watch.service",
    "kubernetes/cronjob.yaml",
)
# Columns of `latest` that are metrics of the same name.
METRICS = (
    *("leakage_change_percent", "leakage_change_lower", "leakage_change_upper"),
    *("alarm_level_percent", "detection_limit_percent"),
    *("own_leakage_l_per_min", "own_leakage_lower", "own_leakage_upper"),
    *("evidence", "evidence_limit", "model_error_percent"),
)


def receivers(folder: Path, web: Hook, mail_port: int) -> str:
    command = json.dumps(["/bin/sh", "-c", 'cat >> "$0"; echo >> "$0"', str(folder / "told")])
    return f"""
[alarms]
command = {command}
webhook_url = "{web.url(HOOK)}"
webhook_headers = {{ Authorization = "Bearer ${{HOOK_SECRET}}" }}
webhook_secret = "${{HOOK_SECRET}}"
[alarms.email]
to = ["shift@plant.example"]
sender = "leakage@plant.example"
server = "smtp://127.0.0.1:{mail_port}"
weekly = ""
"""


def raise_alarms(plant: ScenarioFleet, level: float, before: float | None = None) -> None:
    """From the next run on a rise beyond a level is an alarm."""
    old = "[alarms]\n" if before is None else f"[alarms]\nalarm_percent = {before}\n"
    plant.change("fleet.toml", old, f"[alarms]\nalarm_percent = {level}\n")


def test_receivers_get_the_rows_of_alarms_once(plant: ScenarioFleet) -> None:
    secret = base64.b64encode(SECRET).decode()
    with hook() as web, serving() as server:
        plant.append("fleet.toml", receivers(plant.folder, web, server.port))
        assert plant.run("fit-fleet", HOOK_SECRET=secret).code == 0
        assert (web.posts, server.mails) == ([], [])  # new receivers get what is new
        raise_alarms(plant, 15.0)
        web.answers[HOOK] = (503, "")
        said = [plant.run("fit-fleet", HOOK_SECRET=secret)]
        said += [plant.run("status", *form, HOOK_SECRET=secret) for form in ((), ("--json",))]
        (fleet,) = said[-1].events("fleet")
        waiting = {receiver["receiver"]: receiver["undelivered"] for receiver in fleet["receivers"]}
        refused = web.posts[-1]
        web.answers.clear()
        plant.run("fit-fleet", HOOK_SECRET=secret)
        plant.run("fit-fleet", HOOK_SECRET=secret)
    published = [row for row in plant.table("alarms").to_dicts() if row["to_state"] == "alarm"]
    raised = {(row["motor_id"], str(row["night"]), row["sentence"]) for row in published}
    assert {motor for motor, _, _ in raised} == {"broken", "worn"}
    lines = (plant.folder / "told").read_text().splitlines()
    taken = web.posts[-1]
    for content in (taken.body, *lines):
        document = json.loads(content)
        assert (document["type"], document["fleet"]) == ("alarms", "Scenario")
        rows = {(row["motor_id"], row["night"], row["sentence"]) for row in document["changes"]
            if row["to_state"] == "alarm"}  # fmt: skip
        assert rows == raised
    assert len(lines) == 1
    assert sum(waiting.values()) == len(json.loads(taken.body)["changes"])
    # Tried again with the same bytes and id; signed as Standard Webhooks say.
    assert (refused.body, refused.headers["webhook-id"]) == (
        taken.body,
        taken.headers["webhook-id"],
    )
    head = f"{taken.headers['webhook-id']}.{taken.headers['webhook-timestamp']}."
    digest = hmac.new(SECRET, head.encode() + taken.body, hashlib.sha256).digest()
    assert taken.headers["webhook-signature"] == f"v1,{base64.b64encode(digest).decode()}"
    (mail,) = server.mails
    assert mail["To"] == "shift@plant.example"
    assert "broken alarm" in mail["Subject"]
    text = mail.get_content()
    assert all(reason[1:40] in " ".join(text.split()) for _, _, reason in raised)
    # Nothing of path, query or token is left anywhere.
    assert taken.headers["authorization"] == f"Bearer {secret}"
    written = [path for path in plant.output.rglob("*") if path.is_file()]
    words = "".join(done.out + done.err for done in said).encode()
    for content in (words, *(path.read_bytes() for path in written)):
        assert b"S3CRET" not in content
        assert secret.encode() not in content


def test_metrics_and_heartbeat_say_what_the_tables_say(plant: ScenarioFleet) -> None:
    (plant.folder / "metrics").mkdir()
    plant.append("fleet.toml", '[metrics]\ntextfile = "../metrics/fleet.prom"\n')
    plant.log("calm", 5).write_text("nonsense\n" * 100)
    assert plant.run("fit-fleet").code == 1
    text = (plant.folder / "metrics" / "fleet.prom").read_text()
    samples = dict(line.rsplit(" ", 1) for line in text.splitlines() if not line.startswith("#"))
    by_motor: dict[tuple[str, str], float] = {}
    for name, value in samples.items():
        labels = dict(re.findall(r'(\w+)="([^"]*)"', name))
        if "motor" in labels and labels.get("state", "1"):
            key = name.partition("{")[0].removeprefix("motor_leakage_")
            by_motor[labels["motor"], f"{key}{labels.get('state', '')}"] = float(value)
    for row in plant.table("latest").to_dicts():
        motor = row["motor_id"]
        assert by_motor[motor, f"motor_state{row['state']}"] == 1.0
        for name in METRICS:
            assert by_motor.get((motor, name)) == row[name], name
        assert by_motor[motor, "data_timestamp_seconds"] == row["last_sample"].timestamp()
        assert by_motor[motor, "standing_failures"] == (motor == "calm")
    beat = json.loads((plant.output / "heartbeat.json").read_text())
    assert (beat["state"], beat["n_motors"], beat["n_motors_done"]) == ("finished", 3, 3)
    (run,) = [row for row in plant.table("runs").to_dicts() if row["run_id"] == beat["run_id"]]
    assert (run["status"], run["n_motors_failed"]) == ("motors_failed", 1)


def calls_of(path: Path) -> list[str]:
    """Calls of the command in an example, with the plant's config."""
    calls = re.findall(r"motor-leakage [a-z][^;&|>\n\"]*", path.read_text("utf-8"))
    fleet = re.compile(r"\$\{?FLEET\}?|/fleet/fleet\.toml")
    return [fleet.sub("configs/fleet.toml", call) for call in calls if fleet.search(call)]


def test_examples_do_what_their_page_says(plant: ScenarioFleet) -> None:
    """Each call as it stands: a run in lines for programs, pages, a watch on the last run."""
    calls = {example: calls_of(ROOT / "examples" / example) for example in EXAMPLES}
    assert all(calls.values())
    every = [call for of_example in calls.values() for call in of_example]
    watches = [call for call in every if "--max-age 26h" in call]
    assert {run_line(call.replace("26h", "1s"), plant.folder).code for call in watches} == {1}
    for call in every:
        done = run_line(call, plant.folder)
        assert done.code == 0, done.err
        command = call.split()[1]
        if command == "fit-fleet":
            assert done.events("run")[0]["n_motors"] == 3
        elif command == "report":
            page = plant.output / "report" / "index.html"
            assert "Plan an inspection" in page.read_text("utf-8")
        else:
            assert call in watches
            assert "worn" in done.out


@covers("report --to --nights --output")
def test_pages_say_what_the_tables_say(plant: ScenarioFleet) -> None:
    plant.output.rename(plant.folder / "moved")
    moved = ScenarioFleet(plant.folder, plant.motors, plant.plan, output_name="moved")
    done = plant.run("report", "--output", moved.output, "--to", "pages", "--nights", 3)
    pages = plant.folder / "pages"
    assert done.out.startswith("3 motors, 3 nights updated")
    assert done.out.strip().endswith(str(pages / "index.html"))
    index = (pages / "index.html").read_text("utf-8")
    order = re.findall(r'<tr data-motor="(\w+)">', index)
    status = plant.run("status", "--output", moved.output).out.splitlines()[1:]
    assert order == [line.split("\t")[0] for line in status]
    assert re.findall(r'<li data-motor="(\w+)">', index) == order[:2]  # those that need attention
    for row in moved.table("latest").to_dicts():
        page = (pages / "motors" / f"{row['motor_id']}.html").read_text("utf-8")
        assert row["sentence"][1:].split(";")[0] in page
        assert row["advice"] in index
        nights = sorted((pages / "data" / row["motor_id"]).glob("*2026-01-*"))
        assert [path.stem[-10:] for path in nights] == [f"2026-01-{day}" for day in (19, 20, 21)]
    again = plant.run("report", "--output", moved.output, "--to", "pages", "--nights", 3)
    assert again.out.startswith("3 motors, 0 nights updated, 1 file written")
    nothing = plant.run("report", "--output", plant.folder / "nowhere")
    assert (nothing.code, "run fit-fleet first" in nothing.err) == (4, True)
