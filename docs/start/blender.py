"""Show a folder of PLY files in Blender: each Gaussian is an ellipsoid, and each file a frame.

    blender --python docs/start/blender.py -- out/duck-frames

`phy124 export CLIP --to ply --all` writes the folder. The script removes the cube of Blender's
startup scene, and aims its camera and lamp at the object. Tried with Blender 4.5 and 5.0.
"""

import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

RADIUS = 1.5
"""Radius of an ellipsoid in standard deviations."""


def read_column(mesh, name):
    """Return one column of an imported PLY file."""
    values = np.empty(len(mesh.vertices), np.float32)
    mesh.attributes[name].data.foreach_get("value", values)
    return values


def read_columns(mesh, name, count):
    """Return columns such as scale_0 to scale_2 as an array [N, count]."""
    return np.stack([read_column(mesh, f"{name}_{i}") for i in range(count)], axis=1)


def add(mesh, name, kind, member, values):
    """Add an attribute to a mesh for the geometry nodes to read."""
    attribute = mesh.attributes.new(name, kind, "POINT")
    attribute.data.foreach_set(member, np.ascontiguousarray(values, np.float32).ravel())


def import_frame(path, nodes, frame):
    """Import a file as an object that is visible only in a single frame, and return the object."""
    bpy.ops.wm.ply_import(filepath=str(path), forward_axis="Z", up_axis="NEGATIVE_Y")
    shown, mesh = bpy.context.object, bpy.context.object.data
    quats = read_columns(mesh, "rot", 4)
    rgb = np.clip(0.5 + 0.28209479 * read_columns(mesh, "f_dc", 3), 0, 1)  # degree 0, sRGB
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    add(mesh, "turn", "QUATERNION", "value", quats / np.linalg.norm(quats, axis=1, keepdims=True))
    add(mesh, "size", "FLOAT_VECTOR", "vector", RADIUS * np.exp(read_columns(mesh, "scale", 3)))
    add(mesh, "colour", "FLOAT_COLOR", "color", np.insert(linear, 3, 1, axis=1))
    shown.modifiers.new("ellipsoids", "NODES").node_group = nodes
    for at in (frame - 1, frame, frame + 1):
        shown.hide_viewport = shown.hide_render = at != frame
        shown.keyframe_insert("hide_viewport", frame=at)
        shown.keyframe_insert("hide_render", frame=at)
    return shown


def make_material():
    """Return a material that shows the colour attribute of each instance."""
    material = bpy.data.materials.new("gaussians")
    if bpy.app.version < (5, 0):  # later materials always have nodes
        material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    colour = nodes.new("ShaderNodeAttribute")
    colour.attribute_type, colour.attribute_name = "INSTANCER", "colour"
    links.new(colour.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
    return material


def make_nodes():
    """Return geometry nodes that put an ellipsoid on every point."""
    group = bpy.data.node_groups.new("ellipsoids", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    enter, leave, ball, paint, put, turn, size = map(
        group.nodes.new,
        (
            "NodeGroupInput", "NodeGroupOutput", "GeometryNodeMeshIcoSphere",
            "GeometryNodeSetMaterial", "GeometryNodeInstanceOnPoints",
            "GeometryNodeInputNamedAttribute", "GeometryNodeInputNamedAttribute",
        ),
    )  # fmt: skip
    ball.inputs["Subdivisions"].default_value = 2
    ball.inputs["Radius"].default_value = 1.0
    paint.inputs["Material"].default_value = make_material()
    turn.data_type, turn.inputs["Name"].default_value = "QUATERNION", "turn"
    size.data_type, size.inputs["Name"].default_value = "FLOAT_VECTOR", "size"
    for source, target in (
        (enter.outputs[0], put.inputs["Points"]),
        (ball.outputs["Mesh"], paint.inputs["Geometry"]),
        (paint.outputs[0], put.inputs["Instance"]),
        (turn.outputs["Attribute"], put.inputs["Rotation"]),
        (size.outputs["Attribute"], put.inputs["Scale"]),
        (put.outputs[0], leave.inputs[0]),
    ):
        group.links.new(source, target)
    return group


def aim(shown):
    """Remove the startup scene's cube, and aim its camera and lamp at all objects."""
    if "Cube" in bpy.data.objects:
        bpy.data.objects.remove(bpy.data.objects["Cube"])
    corners = np.array([each.matrix_world @ Vector(at) for each in shown for at in each.bound_box])
    centre, size = corners.mean(axis=0), np.ptp(corners, axis=0).max()
    for name, direction in (("Camera", (0.6, -1.9, 0.6)), ("Light", (1.0, -1.8, 2.0))):
        if placed := bpy.data.objects.get(name):
            placed.location = centre + size * np.array(direction)
            placed.rotation_euler = Vector(-np.array(direction)).to_track_quat("-Z", "Y").to_euler()


def main():
    """Import all files of the folder and set the length of the animation."""
    files, nodes = sorted(Path(sys.argv[-1]).glob("*.ply")), make_nodes()
    shown = [import_frame(path, nodes, frame) for frame, path in enumerate(files, 1)]
    aim(shown)
    bpy.context.scene.frame_end = len(files)
    bpy.context.scene.frame_set(1)


if __name__ == "__main__":
    main()
