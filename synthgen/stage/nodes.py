"""Shader graphs in a few words: `graph.noise(...)`, links made by passing sockets as inputs."""

from __future__ import annotations

from typing import Any

import bpy

Socket = Any
"""A `bpy.types.NodeSocket`, a number, or a tuple of numbers."""


class Graph:
    """A material's or world's node tree, emptied."""

    def __init__(self, owner: bpy.types.Material | bpy.types.World) -> None:
        owner.use_nodes = True
        self.tree = owner.node_tree
        self.tree.nodes.clear()

    def node(
        self, kind: str, inputs: dict[str | int, Socket] | None = None, **settings: Any
    ) -> Any:
        """Add a node of Blender type `ShaderNode<kind>`; set properties, then inputs by name."""
        node = self.tree.nodes.new(f"ShaderNode{kind}")
        for name, value in settings.items():
            setattr(node, name, value)
        for name, value in (inputs or {}).items():
            self.feed(node.inputs[name], value)
        return node

    def feed(self, socket: Any, value: Socket) -> None:
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, socket)
        elif isinstance(value, tuple) and len(value) == 3 and socket.type == "RGBA":
            socket.default_value = (*value, 1.0)
        else:
            socket.default_value = value

    def attribute(self, name: str) -> Any:
        """A mesh or curves attribute; use `.outputs["Color" | "Vector" | "Fac"]`."""
        return self.node("Attribute", attribute_name=name)

    def scalar(self, name: str) -> Any:
        return self.attribute(name).outputs["Fac"]

    def math(self, operation: str, a: Socket, b: Socket = 0.0, clamp: bool = False) -> Any:
        inputs = {0: a, 1: b}
        return self.node("Math", inputs, operation=operation, use_clamp=clamp).outputs[0]

    def combine(self, operation: str, a: Socket, b: Socket) -> Any:
        """Arithmetic on two vectors, such as ADD or MULTIPLY."""
        return self.node("VectorMath", {0: a, 1: b}, operation=operation).outputs["Vector"]

    def stretch(self, value: Socket, low: float, high: float, to: tuple[float, float]) -> Any:
        """Smooth step of `value` from [low, high] to the range `to`, clamped."""
        inputs = {
            "Value": value,
            "From Min": low,
            "From Max": high,
            "To Min": to[0],
            "To Max": to[1],
        }
        return self.node("MapRange", inputs, interpolation_type="SMOOTHSTEP").outputs["Result"]

    def mix(self, factor: Socket, a: Socket, b: Socket, blend: str = "MIX") -> Any:
        """Blend two colours."""
        node = self.node("Mix", data_type="RGBA", blend_type=blend, clamp_factor=True)
        for socket, value in zip((0, 6, 7), (factor, a, b), strict=True):
            self.feed(node.inputs[socket], value)
        return node.outputs[2]

    def noise(self, vector: Socket, scale: float, detail: float = 2.0, rough: float = 0.5) -> Any:
        """Perlin noise in [0, 1] around 0.5; `scale` in cycles per unit of `vector`."""
        inputs = {"Vector": vector, "Scale": scale, "Detail": detail, "Roughness": rough}
        return self.node("TexNoise", inputs).outputs["Fac"]

    def output(self, surface: Socket) -> None:
        self.node("OutputMaterial", {"Surface": surface})
