extends SceneTree
func _initialize() -> void:
	run.call_deferred()
func run() -> void:
	var room = load("res://room.tscn").instantiate()
	root.add_child(room)
	for k in 3:
		await process_frame
	while room.gi.progress < 1.0:
		await process_frame
	room.moves = false
	for shot in [["day", 2.0, true, Vector2(-0.55, -0.12)], ["lamp", 2.0, true, Vector2(-1.1, -0.15)], ["off", 6.0, false, Vector2(-0.3, -0.1)]]:
		room.time = shot[1]
		room.lamp.visible = shot[2]
		room.look = shot[3]
		for k in 4:
			await process_frame
		await RenderingServer.frame_post_draw
		root.get_texture().get_image().save_png("/tmp/gd-%s.png" % shot[0])
		print(shot[0], " ", room.gi.update_time, " ms ", room.gi.updates)
	quit()
