"""Gates of the camera that are legal and probably unintended: those that lose right points."""

from __future__ import annotations

from collections.abc import Iterator

from hexservo.findings.analysis.scene import Scene
from hexservo.findings.gate_width import least_for_noise, moved_in_image, noise_at_gate, predicts, rejects
from hexservo.findings.target_path import moving_keys
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import above, number


def of_gate(scene: Scene) -> Iterator[str]:
    """Yield a sentence for a gate that noise or the target's motion exceed."""
    camera = scene.scenario.camera
    if camera.gate is None or not predicts(scene.scenario):
        return
    noise = noise_at_gate(scene.scenario)
    if camera.gate < least_for_noise(noise):
        yield (
            f"camera.gate: {number(camera.gate)} px {rejects(camera.gate, noise)}, so that the law acts on older "
            f"images and, beyond camera.timeout, on none; take a gate of at least {above(least_for_noise(noise), 2)} px"
        )
    moved = moved_in_image(scene)
    if moved > camera.gate:
        yield (
            f"camera.gate: {number(camera.gate)} px is less than the {number(moved)} px that "
            f"{moving_keys(scene.scenario)[0]} moves the image from frame to frame, so that right points count as "
            "lost; widen the gate"
        )


def of_gate_without_timeout(scenario: Scenario) -> Iterator[str]:
    """Yield a sentence for a gate without timeout: a note, since runs show whether points go elsewhere in them."""
    camera = scenario.camera
    if camera.gate is not None and camera.timeout is None and predicts(scenario):
        yield (
            "camera.gate: a point that has gone elsewhere is never found again without camera.timeout; set that to "
            "some frame periods beyond the latency"
        )
