FEA := $(SHARDS:%=$D/30_fea/%.csv)

fea: $(FEA) $(call barrier,30_fea)  ## solve every accepted sample by finite elements

$(FEA): $D/30_fea/%.csv: $D/10_poses/%.csv $P/fea.json $(if $(MESHES),$D/20_meshes/%.csv) \
    | $(IMAGES_JUDGED) $(call barrier,10_poses 20_meshes)
	$(call step,gelforge.stages.fea $D $*)

deck:  ## CalculiX' deck of one sample as a self-contained folder: make deck ID=…
	@$(PY) -m gelforge.commands.deck $D --id $(call given,ID)
